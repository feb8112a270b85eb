"""What steers a vehicle from outside: components that `fmu.builtin` describes and `instances.live` runs.

declare    their variables
manual     `mavlink_manual`: a person at a ground station
motors     `mavlink_motors`: between the controller and the thrusters of a vehicle that a person steers
ardupilot  `ardupilot_json`: ArduPilot's own software
"""
