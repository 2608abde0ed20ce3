"""Drives the yellow robot 0 to the ball with the package vsss-client, until it is ended."""

import math

import vsss_client as vsss

with open("client.ini", "w") as config:
    config.write(
        "[FIRA]\nvision_address = 224.0.0.1\nvision_port = 10002\n"
        "command_address = 127.0.0.1\ncommand_port = 20011\n"
    )
client = vsss.FIRASim("client.ini")
while True:
    frame = client.frame()
    robot = next((robot for robot in frame.robots_yellow if robot.robot_id == 0), None)
    if robot is None or not frame.HasField("ball"):
        continue
    # Metres and radians; wheels of 26 mm radius turn at speed / 0.026 rad/s.
    x, y = frame.ball.x - robot.x, frame.ball.y - robot.y
    turn = math.remainder(math.atan2(y, x) - robot.orientation, 2 * math.pi)
    forward = 0.6 * max(math.cos(turn), 0)
    left, right = forward - 0.15 * turn, forward + 0.15 * turn
    command = vsss.Command(vsss.Team.YELLOW, 0, left / 0.026, right / 0.026)
    client.send_command([command])
