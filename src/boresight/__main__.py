"""``python -m boresight``."""

from .cli import main

main()
