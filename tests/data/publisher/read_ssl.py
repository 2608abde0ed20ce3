"""Prints what the package sslclient understands of SSL-Vision packets: so many frames, and a geometry."""

import json
import socket
import sys

import sslclient

# The client joins its group on the interface of the computer's own name.
socket.gethostname = lambda: "localhost"

client = sslclient.client()
client.connect()
client.sock.settimeout(30)
frames = geometries = 0
while frames < int(sys.argv[1]) or geometries == 0:
    packet = client.receive()
    if packet.HasField("geometry"):
        geometries += 1
        field = packet.geometry.field
        print(json.dumps({
            "field_length": field.field_length,
            "lines": len(field.field_lines),
            "cameras": len(packet.geometry.calib),
        }))
    if packet.HasField("detection"):
        frames += 1
        detection = packet.detection
        robots = {robot.robot_id: [robot.x, robot.y] for robot in detection.robots_yellow}
        print(json.dumps({"frame": detection.frame_number, "yellow": robots}))
