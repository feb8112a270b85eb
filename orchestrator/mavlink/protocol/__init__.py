"""What is said between a vehicle and a ground station.

dialect       messages and constants, from pymavlink
wire          bytes to messages and back
links         endpoints
telemetry     messages that a vehicle sends about itself
ftp           the parameters as a file
station       what a station is sent, and when
commands      COMMAND_LONG and COMMAND_INT
steering      joysticks and set points
conversation  every other request
"""
