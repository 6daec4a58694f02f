"""Scenes whose errors are known: aircraft and ships, radars with any list of error terms, ADS-B and AIS, and files of them."""

from .demo import association_scene, demo_scene, write_demo
from .drift import Drift, Sine, Step
from .files import SceneFiles, write_scene
from .radar import Clutter, Gaps, Noise, Radar, observe_radar
from .reference import Adsb, Ais, AisLog, Mlat, Receiver, Rtk, observe_adsb, observe_ais
from .scenario import Scenario, Simulated, lint_scenario, load_scenario, simulate
from .targets import Target, Waypoint
from .truth import Airport, Atmosphere, Shipping, Ships, Traffic, Truth
from .vessel import Vessel

__all__ = [
    "Adsb",
    "Airport",
    "Ais",
    "AisLog",
    "Atmosphere",
    "Clutter",
    "Drift",
    "Gaps",
    "Mlat",
    "Noise",
    "Radar",
    "Receiver",
    "Rtk",
    "Scenario",
    "SceneFiles",
    "Shipping",
    "Ships",
    "Simulated",
    "Sine",
    "Step",
    "Target",
    "Traffic",
    "Truth",
    "Vessel",
    "Waypoint",
    "association_scene",
    "demo_scene",
    "lint_scenario",
    "load_scenario",
    "observe_adsb",
    "observe_ais",
    "observe_radar",
    "simulate",
    "write_demo",
    "write_scene",
]
