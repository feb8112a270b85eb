"""What is known of one vehicle.

sample      its state at one instant
autopilot   its mode and arming, and the samples that wait for the bridge
parameters  those of ArduSub
frame       its thrusters in ArduSub's numbering, and PWM
modes       what ArduSub holds in which flight mode
control     what a pilot asks of it
"""
