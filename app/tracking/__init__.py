"""People over time: sessions, tracks, poses, actions, events. Imports estimation and below.

Timestamps are seconds and ascend; boxes and points are in pixels of the frame once they are square.
"""
