"""The report of a calibration: one HTML file that needs nothing else."""

from .page import write_report as write_report
