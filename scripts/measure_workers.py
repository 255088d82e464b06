"""Measure what memory each worker process costs.

python -m scripts.measure_workers [--workers 1 2 3] [--write]
"""

from __future__ import annotations

import asyncio

from index.store import PoseIndex
from scripts.open_loop import ClosedLoop
from scripts.overload import calls
from scripts.results import conclude, machine, measurement_parser, revision
from scripts.server_process import ServerProcess

SECONDS_A_WORKER = 5.0


def main() -> None:
    """Command line."""
    parser = measurement_parser("Measure what memory each worker costs.")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 3])
    options = parser.parse_args()
    kinds = calls(PoseIndex.load(options.index))
    requests = [call for kind in kinds.values() for call in kind]
    rows = []
    for workers in options.workers:
        with ServerProcess(options.index, WORKERS=str(workers)) as server:
            server.wait_until_ready()
            # Connections are spread over the workers by the system: several for each.
            loop = ClosedLoop(server.url, requests)
            asyncio.run(loop.run(4 * workers, SECONDS_A_WORKER * workers))
            rows.append(f"| {workers} | {server.shared_out_memory_mb():.0f} MB |")
    body = f"""`python -m scripts.measure_workers`, revision {revision()}. {machine()}.

| `WORKERS` | all processes together, under load |
|---|---|
{chr(10).join(rows)}

Pages that several processes share are counted once (proportional set size)."""
    conclude("Memory of workers", body, write=options.write)


if __name__ == "__main__":
    main()
