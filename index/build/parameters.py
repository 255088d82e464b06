"""Numbers of the rendering on a cluster."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RenderingParameters:
    """Shards of the simulation, and the cluster that may draw them; see :mod:`.simulate`."""

    # Poses rendered at a time: a second or two of work
    shard_poses: int = 100
    # Shards handed out at a time: enough for the threads of a large cluster, 40 MB of transforms
    max_pending: int = 128
    # Seconds that a scheduler may take to answer
    connect_s: float = 5.0
    # Seconds that the first worker may take to join
    first_worker_s: float = 60.0


RENDERING = RenderingParameters()
