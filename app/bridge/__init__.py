"""The bridge between a camera and a service: frames in, events out; see :mod:`.command`."""
