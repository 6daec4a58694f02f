"""Scenes whose errors are known: aircraft, radars with any list of error terms, ADS-B, and files of them."""

from .demo import association_scene, demo_scene, write_demo
from .radar import Adsb, Radar, observe_adsb, observe_radar
from .scenario import Scenario, Simulated, load_scenario, simulate
from .truth import Airport, Atmosphere, Traffic, Truth

__all__ = [
    "Adsb",
    "Airport",
    "Atmosphere",
    "Radar",
    "Scenario",
    "Simulated",
    "Traffic",
    "Truth",
    "association_scene",
    "demo_scene",
    "load_scenario",
    "observe_adsb",
    "observe_radar",
    "simulate",
    "write_demo",
]
