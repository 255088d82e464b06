"""One entry for all commands: ``python -m scripts COMMAND [arguments]``."""

import importlib
import logging
import os
import sys
from collections.abc import Sequence

# As in the service; NumPy's BLAS reads it once, when it is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")

COMMANDS = {
    "build": ("scripts.build", "build an index from motion capture"),
    "train-reranker": ("scripts.training.train_reranker", "train the re-ranking network"),
    "train-silhouette-postures": (
        "scripts.training.train_silhouette_postures",
        "train the postures of silhouettes alone",
    ),
    "train-elevation": (
        "scripts.training.train_elevation",
        "train the network of camera elevations",
    ),
    "render-people": ("scripts.training.render_people", "render people as photographs"),
    "train-photographs": (
        "scripts.training.train_photograph_models",
        "train depth and trust on rendered people",
    ),
    "render-postures": (
        "scripts.training.render_postures",
        "render people, hide and spoil them, and let the service read them",
    ),
    "train-postures": (
        "scripts.training.train_postures",
        "train the postures of photographs on what was read",
    ),
    "render-films": (
        "scripts.training.render_films",
        "render films of falls and daily life that a camera session reads",
    ),
    "train-falls": ("scripts.training.train_falls", "train the model of falls on simulated tracks"),
    "train-identity": (
        "scripts.training.train_identity",
        "train the network of identities on rendered films",
    ),
    "fit-people": (
        "scripts.training.fit_people",
        "fit detection scores to the street video and rendered photographs",
    ),
    "fit-paper": (
        "scripts.training.fit_paper",
        "fit confidence and detection score of the paper's method",
    ),
    "simulate-paper": (
        "scripts.experiments.paper_simulation",
        "render the data of the paper's experiments",
    ),
    "render-held-out": (
        "scripts.experiments.rendered_people",
        "render the people on whom steps are compared",
    ),
    "fit-confidence": (
        "scripts.training.fit_confidence",
        "fit confidences to rendered people and simulated silhouettes",
    ),
    "publish": ("scripts.publish", "load an index into Milvus"),
    "evaluate": ("scripts.evaluate", "run experiments and write their pages"),
    "figures": ("scripts.figures", "write figures from the JSON into pages and documents"),
    "results": ("scripts.play_results", "measure again what is older than the code"),
    "bench": ("scripts.load.bench", "time whole requests against a yardstick"),
    "peer": ("scripts.load.peer", "price a camera's frames beside MediaPipe Pose"),
    "profile": ("scripts.load.profile", "print where the time of a frame goes, stage by stage"),
    "soak": ("scripts.load.soak", "send many mixed requests; watch memory and latency"),
    "cameras": ("scripts.load.cameras", "play the cameras of a house to a server"),
    "mutants": ("scripts.mutants", "break the code a line at a time; print what no test notices"),
    "debug-frame": ("scripts.debug_frame", "draw every step of one photograph"),
    "openapi": ("scripts.openapi", "write openapi.json"),
    "pictures": ("scripts.pictures", "draw the pictures of the documents"),
    "track-video": ("scripts.track_video", "annotate a video with tracked people"),
}
"""Module with ``main(arguments)``, imported only when its command runs, and a line about it."""


_SMALLER = {
    "track_video": (".venv", ".venv/.stamp"),
    "load": (".venv-dev", ".venv-dev/.stamp"),
    "mutants": (".venv-dev", ".venv-dev/.stamp"),
}
"""Environments of gigabytes less than ``.venv-build`` that have what some modules need, and the
targets of make that install it."""


def main(arguments: Sequence[str]) -> int:
    """Run a command and return its exit status; one sentence says what is missing."""
    name, *rest = arguments or ["--help"]
    if name in ("-h", "--help"):
        print(usage())
        return 0
    if name not in COMMANDS:
        print(f"scripts: expected a command, got {name!r}\n\n{usage()}", file=sys.stderr)
        return 2
    sys.argv[0] = f"scripts {name}"  # argparse takes its program name from here.
    logging.basicConfig(format="%(message)s", stream=sys.stdout)
    for package in ("index", "scripts"):
        logging.getLogger(package).setLevel(logging.INFO)
    try:
        return importlib.import_module(COMMANDS[name][0]).main(rest) or 0
    except ModuleNotFoundError as error:
        if not error.name or error.name.startswith("scripts"):
            raise
        package = error.name.partition(".")[0]
        folder, target = _SMALLER.get(
            COMMANDS[name][0].split(".")[1], (".venv-build", ".venv-build/.stamp")
        )
        message = (
            f"expected the package {package}, which `make {target}` installs: "
            f"then `{folder}/bin/python -m scripts {name}`"
        )
    except (OSError, ValueError) as error:
        message = str(error)
    print(f"{name}: {message}", file=sys.stderr)
    return 1


def usage() -> str:
    """Return the list of commands."""
    lines = [f"  {name:25} {line}" for name, (_, line) in COMMANDS.items()]
    return "\n".join(["python -m scripts COMMAND [arguments]", "", *lines])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
