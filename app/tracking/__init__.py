"""People over time: tracks, poses, actions, events. Imports estimation and below.

Timestamps are seconds and ascend. Boxes and points are in pixels of the rectified frame.
"""
