"""Scenes whose errors are known: aircraft and ships, radars with any list of error terms, ADS-B and AIS, and files of them."""

from .demo import association_scene, demo_scene, write_demo
from .radar import Adsb, Ais, AisLog, Radar, observe_adsb, observe_ais, observe_radar
from .scenario import Scenario, Simulated, load_scenario, simulate
from .truth import Airport, Atmosphere, Shipping, Ships, Traffic, Truth

__all__ = [
    "Adsb",
    "Airport",
    "Ais",
    "AisLog",
    "Atmosphere",
    "Radar",
    "Scenario",
    "Shipping",
    "Ships",
    "Simulated",
    "Traffic",
    "Truth",
    "association_scene",
    "demo_scene",
    "load_scenario",
    "observe_adsb",
    "observe_ais",
    "observe_radar",
    "simulate",
    "write_demo",
]
