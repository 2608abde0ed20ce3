"""Attaches to a Touchline group of another user; needs only Python 3.10.

The configuration of the group names the users who may (`access.group`); `touchline status`, run by
its owner, shows the socket. Run as a program, this prints poses, and drives a robot if asked to:

    python touchline_gateway.py /run/touchline-match/match.gateway/socket --spin blue 1
"""

import argparse
import json
import select
import socket
import time

from touchline_messages import Commands, Team, WheelCommand, WorldFrame

MOST_BYTES = 1 << 20


class Refused(Exception):
    """The gateway refused the connection, or has another version."""


class Gateway:
    """A connection. It ends with the group or the gateway; then connect again."""

    def __init__(self, path):
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self.socket.connect(path)
        except PermissionError:
            raise Refused(f"{path}: you must be in the group that access.group names") from None
        greeting = json.loads(self.socket.recv(4096))
        if "refused" in greeting:
            raise Refused(greeting["refused"])
        for layout, here in ((greeting["world"], WorldFrame), (greeting["commands"], Commands)):
            if layout["type"] != here.type_name():
                raise Refused(f"it speaks of {layout['type']}, this program of {here.type_name()}")
        self.drives = False

    def worlds(self, timeout_s=1.0):
        """Every `world`, in order, until none arrives in time or the gateway is gone."""
        while select.select([self.socket], [], [], timeout_s)[0]:
            data = self.socket.recv(MOST_BYTES)
            if not data:
                return
            yield WorldFrame.from_buffer_copy(data)

    def newest(self, timeout_s=1.0):
        """The newest `world`: older ones are skipped. None if none arrives in time."""
        world = next(self.worlds(timeout_s), None)
        while (later := next(self.worlds(0), None)) is not None:
            world = later
        return world

    def send(self, commands):
        """Sends commands for any number of robots. Put all robots into one message."""
        if not self.drives:
            self.socket.send(Commands.type_name().encode())
            self.drives = True
        self.socket.send(bytes(commands))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("socket")
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--spin", nargs=2, metavar=("TEAM", "NUMBER"), help="let a robot turn")
    arguments = parser.parse_args()
    ends = time.monotonic() + arguments.seconds
    gateway = Gateway(arguments.socket)
    frames, missed, last = 0, 0, None
    for world in gateway.worlds():
        frames += 1
        missed += 0 if last is None else world.frame.seq - last - 1
        last = world.frame.seq
        if arguments.spin:
            name = (Team[arguments.spin[0].upper()].value, int(arguments.spin[1]))
            now_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
            message = Commands(seq=frames, t_sent_ns=now_ns, wheel_count=1)
            message.wheels[0] = WheelCommand(*name, -200.0, 200.0)
            gateway.send(message)
        if frames % 80 == 1:
            for robot in world.robots[: world.robot_count]:
                print(
                    f"{world.frame.seq} {Team(robot.team).name.lower()} {robot.robot_id}: "
                    f"{robot.x_mm:.0f} {robot.y_mm:.0f} mm, {robot.orientation:.2f} rad"
                )
        if time.monotonic() > ends:
            break
    print(f"{frames} frames, {missed} missed")


if __name__ == "__main__":
    main()
