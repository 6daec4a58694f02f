"""The report of a calibration, and the comparison of two: HTML files that need nothing else."""

from .evidence import Evidence as Evidence
from .evidence import gather as gather
from .page import write_report as write_report
