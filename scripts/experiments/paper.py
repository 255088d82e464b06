"""The experiments of Atrevi et al. (VISAPP 2016) on data simulated by the paper's recipe."""

from __future__ import annotations

import argparse

from scripts.experiments import paper_descriptors, paper_motion, paper_noise, paper_order
from scripts.experiments.protocol import paper_data

COMMAND = "python -m scripts.evaluate paper"


def add_arguments(parser: argparse._ArgumentGroup) -> None:
    """The paper's experiments have no options."""


def run(options: argparse.Namespace) -> None:
    """Run all four and write ``paper-*.{md,json,png}``."""
    motion = options.shared / "mocap"
    data = paper_data(motion, progress=True)
    choice = paper_noise.run(data, options.out, COMMAND)
    paper_order.run(data, choice, options.out, COMMAND)
    paper_descriptors.run(data, choice, options.out, COMMAND)
    paper_motion.run(data, motion, choice, options.out, COMMAND)
