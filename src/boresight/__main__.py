"""``python -m boresight``, and what the command ``boresight`` starts."""

from __future__ import annotations


def main() -> None:
    """Run the command line; Ctrl-C is one line from the very beginning, while modules are still being imported."""
    try:
        from .cli import main as run
    except KeyboardInterrupt:
        import sys

        print("boresight: interrupted; nothing half-written was left", file=sys.stderr)
        raise SystemExit(130) from None
    run()


if __name__ == "__main__":
    main()
