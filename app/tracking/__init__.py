"""People over time: camera sessions, tracks, smoothed poses, actions and events."""
