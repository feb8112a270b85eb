"""The MAVLink bridge: ground stations see the simulated vehicles as ArduSub.  `experiment.mavlink` reads [mavlink].

vehicle     what is known of one vehicle: its state, parameters, thrusters and steering; needs no pymavlink
protocol    what is said: messages, requests and answers, frames, endpoints
components  what steers a vehicle from outside: `mavlink_manual` with `mavlink_motors`, `ardupilot_json`
fleet       the vehicles of a plan as autopilots
view        samples of them during a run
bridge      the observer of a run that shows them, and its thread
steered     which vehicle a component steers
tlog        the frames of a run in a file
"""
