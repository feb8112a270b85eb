"""The MAVLink bridge: ground stations see the simulated vehicles as ArduSub.

settings   the [mavlink] table of an experiment          frame      thrusters of ArduSub's vectored frame, and PWM
sample     what is known of a vehicle at an instant      telemetry  the messages made of it
autopilot  what a vehicle answers with: modes, parameters (parameters), files (ftp)
commands, conversation                                   requests and their answers
links, wire                                              endpoints, frames, signing
bridge     an observer of the run, and a thread of its own
manual, ardupilot                                        components that steer a vehicle from outside
tlog       frames with their times, in a file
"""
