"""How good it is: residuals of plots against a reference, before and after correction."""

from .residuals import Residuals as Residuals
from .residuals import residuals as residuals
