"""A small ArduPilot for the tests: it speaks SITL's JSON protocol and holds a depth and a heading."""

import json
import math
import socket
import struct

PACKET = struct.Struct("<HHI16H")
MAGIC = 18458
SILENCE = 1.0  # s, after which ArduPilot sends the same packet again


def parsed(data):
    """The state, read as ArduPilot does: the text between the last two newlines, keys searched for as text."""
    text = data.decode()
    assert text.startswith("\n")
    assert text.endswith("\n")
    line = text.rstrip("\n").rpartition("\n")[2]
    assert line.index('"timestamp":') < line.index('"imu":') < line.index('"gyro":[') < line.index('"accel_body":[')
    return json.loads(line)


class FakeArdupilot:
    """u_of: state -> PWM of motors 1 to 6."""

    def __init__(self, port, pwm_of, rate=400):
        self.address, self.pwm_of, self.rate = ("127.0.0.1", port), pwm_of, rate
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.states, self.count = [], 0

    def send(self, pwm):
        outputs = [*pwm, *[0] * (16 - len(pwm))]
        self.socket.sendto(PACKET.pack(MAGIC, self.rate, self.count, *outputs), self.address)

    def fly(self, packets, resend=False):
        """Exchange packets until the other side is gone.  resend: ask for one answer twice, as after a loss."""
        pwm = [1500] * 6
        self.socket.settimeout(SILENCE)
        for _ in range(packets):
            self.count += 1
            for _ in range(20):
                self.send(pwm)
                if resend and self.count == 3:
                    self.send(pwm)
                try:
                    data = self.socket.recv(1 << 16)
                    break
                except (TimeoutError, ConnectionRefusedError):
                    continue
            else:
                return
            state = parsed(data)
            if not self.states or state["timestamp"] > self.states[-1]["timestamp"]:
                self.states.append(state)
            pwm = self.pwm_of(state)


def hover(depth, heading=0.0):
    """A depth and heading hold through ArduSub's vertical motors 5 and 6 and the yaw column of 1 to 4."""

    def pwm_of(state):
        z, w = state["position"][2], state["velocity"][2]
        psi, r = state["attitude"][2], state["imu"]["gyro"][2]
        up = max(-1.0, min(1.0, 1.5 * (z - depth) + 1.5 * w))
        turn = max(-0.5, min(0.5, 0.8 * math.remainder(heading - psi, 2 * math.pi) - 0.5 * r))
        yaw = [turn, -turn, -turn, turn]
        return [round(1500 + 400 * value) for value in (*yaw, -up, -up)]

    return pwm_of
