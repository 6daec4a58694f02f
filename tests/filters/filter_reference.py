"""The textbook's equations, written out in NumPy for one target: what the compiled filters must equal."""

from __future__ import annotations

import numpy as np


def kalman(z, r, time_s, matrices, x, p):
    """Means (K, d), covariances (K, d, d) and NIS (K,) of one target; `matrices(dt)` gives F and Q; NaN rows are missing."""
    k = z.shape[1]
    h = np.eye(k, len(x))
    means, spreads, nis = [x], [p], [np.nan]
    for step in range(1, len(z)):
        f, q = matrices(time_s[step] - time_s[step - 1])
        x, p = f @ x, f @ p @ f.T + q
        nis.append(np.nan)
        if np.isfinite(z[step]).all():
            s = h @ p @ h.T + r[step]
            v = z[step] - h @ x
            gain = p @ h.T @ np.linalg.inv(s)
            x, p = x + gain @ v, (np.eye(len(x)) - gain @ h) @ p
            nis[-1] = v @ np.linalg.solve(s, v)
        means.append(x)
        spreads.append(p)
    return np.array(means), np.array(spreads), np.array(nis)


def imm(z, r, time_s, matrices, change, x, p, probability):
    """Means (K, d), covariances (K, d, d), probabilities (K, M) of one target; `matrices` is a list, `change(dt)` is (M, M)."""
    k, count = z.shape[1], len(matrices)
    h = np.eye(k, len(x))
    xs, ps, mu = [x] * count, [p] * count, np.asarray(probability, float)
    means, spreads, chances = [x], [p], [mu]
    for step in range(1, len(z)):
        dt = time_s[step] - time_s[step - 1]
        t = change(dt)
        prior = t.T @ mu
        new_x, new_p, like = [], [], []
        for j in range(count):
            w = t[:, j] * mu / prior[j]
            x0 = sum(w[i] * xs[i] for i in range(count))
            p0 = sum(w[i] * (ps[i] + np.outer(xs[i] - x0, xs[i] - x0)) for i in range(count))
            f, q = matrices[j](dt)
            x1, p1 = f @ x0, f @ p0 @ f.T + q
            like.append(1.0)
            if np.isfinite(z[step]).all():
                s = h @ p1 @ h.T + r[step]
                v = z[step] - h @ x1
                gain = p1 @ h.T @ np.linalg.inv(s)
                like[-1] = np.exp(-0.5 * v @ np.linalg.solve(s, v)) / np.sqrt(np.linalg.det(2 * np.pi * s))
                x1, p1 = x1 + gain @ v, p1 - gain @ s @ gain.T
            new_x.append(x1)
            new_p.append(p1)
        xs, ps = new_x, new_p
        mu = prior * like / (prior * like).sum()
        mean = sum(m * q for m, q in zip(mu, xs, strict=True))
        means.append(mean)
        spreads.append(sum(m * (s + np.outer(q - mean, q - mean)) for m, q, s in zip(mu, xs, ps, strict=True)))
        chances.append(mu)
    return np.array(means), np.array(spreads), np.array(chances)
