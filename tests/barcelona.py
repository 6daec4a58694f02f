"""What is known of the sensors of Barcelona airport in 2016: the text of a sensors.toml that several tests need."""

SENSORS = """
[[sensor]]
name = "SMR"
sac = 0
sic = 7
lat_deg = 41.29561833
lon_deg = 2.095114167
height_m = 85.0
kind = "surface"
scan_s = 1.0

[[sensor]]
name = "MLAT"
sac = 0
sic = 107
lat_deg = 41.297079
lon_deg = 2.078463
height_m = 51.0
kind = "mlat"
"""
