"""Studies: one paper each, its scenes run with our methods, every printed number beside ours.

A study is a function `run(settings) -> Study` of its own module; `run_study` finds it by the name that the command line gives.
"""

from __future__ import annotations

from .page import write_study
from .table import Bound, Row, Settings, Study, check_name, run_study, study_json, study_names

__all__ = ["Bound", "Row", "Settings", "Study", "check_name", "run_study", "study_json", "study_names", "write_study"]
