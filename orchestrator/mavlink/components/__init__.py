"""What steers a vehicle from outside: components that `fmu.builtin` describes and `instances.live` runs.

declare    their variables
manual     `mavlink_manual`: a person at a ground station
ardupilot  `ardupilot_json`: ArduPilot's own software
"""
