"""Scenes whose errors are known: aircraft and ships, radars with any list of error terms, ADS-B and AIS, and files of them."""

from .demo import association_scene, demo_scene, write_demo
from .drift import Drift, Sine, Step
from .radar import Adsb, Ais, AisLog, Clutter, Gaps, Noise, Radar, observe_adsb, observe_ais, observe_radar
from .scenario import Scenario, Simulated, load_scenario, simulate
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
    "Noise",
    "Radar",
    "Scenario",
    "Shipping",
    "Ships",
    "Simulated",
    "Sine",
    "Step",
    "Traffic",
    "Truth",
    "Vessel",
    "association_scene",
    "demo_scene",
    "load_scenario",
    "observe_adsb",
    "observe_ais",
    "observe_radar",
    "simulate",
    "write_demo",
]
