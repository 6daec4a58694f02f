"""Filters: one target's state from the measurements of any number of radars, taken in one by one in the order of time."""

from .alpha_beta import AlphaBeta, alpha_beta_filter
from .imm import ExpectedMode, Imm, Mixed, imm_filter
from .kalman import Filtered, kalman_filter, one_point, range_rate_start, two_point
from .motion import ConstantAcceleration, ConstantVelocity, CoordinatedTurn, Motion, Singer, matrices
from .polar import ExtendedKalman, RadarPlots, UnscentedKalman, radar_filter, radar_imm, radar_plots, radar_start
from .smooth import Smoothed, smooth, smooth_models

__all__ = [
    "AlphaBeta",
    "ConstantAcceleration",
    "ConstantVelocity",
    "CoordinatedTurn",
    "ExpectedMode",
    "ExtendedKalman",
    "Filtered",
    "Imm",
    "Mixed",
    "Motion",
    "RadarPlots",
    "Singer",
    "Smoothed",
    "UnscentedKalman",
    "alpha_beta_filter",
    "imm_filter",
    "kalman_filter",
    "matrices",
    "one_point",
    "radar_filter",
    "radar_imm",
    "radar_plots",
    "radar_start",
    "range_rate_start",
    "smooth",
    "smooth_models",
    "two_point",
]
