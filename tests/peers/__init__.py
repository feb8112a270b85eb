"""What the tests let orch talk to or be compared with: stations, an ArduPilot, other masters, mutated files."""
