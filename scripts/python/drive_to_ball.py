"""Drives one robot to the ball: the smallest strategy. The same in Rust: examples/drive_to_ball.rs

Start `touchline run` in another terminal; robots of the synthetic match obey.
"""

import argparse
import math

import touchline
from touchline_messages import Commands, Team, WheelCommand

WHEEL_BASE_MM = 70.0
FASTEST_MM_S = 500.0
NEAR_MM = 70.0


def towards(robot, ball):
    """The wheel speeds that bring the robot nearer to the ball, and how far it is away.

    What counts is where both will be when the command acts.
    """
    x = ball.predicted_x_mm - robot.predicted_x_mm
    y = ball.predicted_y_mm - robot.predicted_y_mm
    turn = math.remainder(math.atan2(y, x) - robot.predicted_orientation, math.tau)
    distance = max(math.hypot(x, y) - NEAR_MM, 0.0)
    # Straight ahead only if it faces the ball.
    speed = min(3.0 * distance, FASTEST_MM_S) * max(math.cos(turn), 0.0)
    difference = min(max(4.0 * turn * WHEEL_BASE_MM / 2.0, -200.0), 200.0)
    return speed - difference, speed + difference


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--instance", default="default")
    parser.add_argument("--team", default="blue", choices=["blue", "yellow"])
    parser.add_argument("--robot", type=int, default=1)
    arguments = parser.parse_args()
    name = (Team[arguments.team.upper()].value, arguments.robot)

    group = touchline.Group(arguments.instance, "drive_to_ball")
    commands = group.writer("commands")
    seq = 0
    for world in group.reader("world").messages(timeout_s=10):
        for robot in world.robots[: world.robot_count]:
            if (robot.team, robot.robot_id) == name:
                left, right = towards(robot, world.ball)
                message = Commands(seq=seq, t_sent_ns=touchline.monotonic_ns(), wheel_count=1)
                message.wheels[0] = WheelCommand(*name, left, right)
                commands.send(message)
                seq += 1


with touchline.until_interrupted():
    main()
