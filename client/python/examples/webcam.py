"""Maps what a webcam, or a video file, shows: python webcam.py [NUMBER or FILE] [SERVER]. Needs OpenCV."""

import sys

import cv2

from monoslam import Camera, Client, captures

source = sys.argv[1] if len(sys.argv) > 1 else "0"
is_live = source.isdigit()
capture = cv2.VideoCapture(int(source) if is_live else source)
width, height = (int(capture.get(n)) for n in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
frames = captures(capture, fps=None if is_live else capture.get(cv2.CAP_PROP_FPS))

with Client(*sys.argv[2:3]) as client:
    session = client.create_session("", Camera.from_field_of_view(width, height))
    print(f"Move sideways. See it at {client.http_address()}/#/s/{session.id}")
    for answer in client.stream(session.id, frames, policy="realtime" if is_live else "lossless"):
        print(answer.sequence, answer.pose.position.round(3) if answer.pose else answer.reason)
