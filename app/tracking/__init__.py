"""People over time: sessions, tracks, poses, actions, events. Imports estimation and below."""
