"""Logs where the robots are: a consumer in a dozen lines. Usage: log_poses.py [INSTANCE]"""

import sys

import touchline

with touchline.until_interrupted():
    world = touchline.Group(sys.argv[1] if len(sys.argv) > 1 else "default", "log_poses").reader("world")
    for message in world.messages(timeout_s=10):
        for robot in message.robots[: message.robot_count]:
            print(message.frame.seq, robot.team, robot.robot_id, round(robot.x_mm), round(robot.y_mm))
