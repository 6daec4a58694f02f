"""Boresight finds, removes and proves the systematic errors of radars."""
