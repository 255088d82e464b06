"""The paper's figure 5: recognition over the order of the moments."""

from __future__ import annotations

from pathlib import Path

from tqdm import tqdm

from descriptor.descriptor import Descriptor, DiagonalDescriptor
from index.build.learn import Recipe, discriminate, measure_scatter
from scripts.experiments.answers import FAULTS, SEED, Choice, nearest_errors
from scripts.experiments.contour import disturb_all
from scripts.experiments.paper_pictures import plot_order
from scripts.experiments.protocol import PaperData, recognised
from scripts.experiments.report import percent, table, write

ORDERS = tuple(range(1, 41))
BLOCKS = tuple(range(4, 49, 4))
"""Vertical orders of the discriminant descriptor; half as many horizontal ones."""

STDS_PX = (0.0, 2.0)
DIAGONAL, DISCRIMINANT = "diagonal", "discriminant"

Curve = dict[int, list[float]]


def run(data: PaperData, choice: Choice, out: Path, command: str) -> None:
    """Measure both curves and write ``paper-order.*``."""
    largest = Recipe(max(BLOCKS), max(BLOCKS) // 2)
    scatter = measure_scatter(data.known, SEED, largest, faults=FAULTS[choice.faults])
    recipe = Recipe()
    silhouettes = {
        std: disturb_all(data.unseen.silhouettes(slice(None)), std, SEED) for std in STDS_PX
    }
    curves: dict[str, dict[str, Curve]] = {DIAGONAL: {}, DISCRIMINANT: {}}

    def measure(name: str, order: int, descriptor: Descriptor) -> None:
        for std, asked in silhouettes.items():
            errors = nearest_errors(data.known, descriptor, data.unseen, asked)
            curve = curves[name].setdefault(f"{std:g}", {})
            curve[order] = [recognised(errors, n) for n in (1, 7)]

    for order in tqdm(ORDERS, desc="diagonal moments", unit="order"):
        measure(DIAGONAL, order, DiagonalDescriptor(order))
    for order in tqdm(BLOCKS, desc="discriminant moments", unit="order"):
        part = scatter.below(order, order // 2)
        dimension = min(recipe.dimension, len(part.total))
        measure(DISCRIMINANT, order, discriminate(part, dimension, recipe.regularisation))
    out.mkdir(parents=True, exist_ok=True)
    plot_order(curves, out / "paper-order.png")
    write(out, "paper-order", command, [
        "Recognition over the order of the moments",
        "Share of the unseen silhouettes, in percent, of which one of the N nearest known ones "
        "has a mean joint reprojection error below 5 px. *Diagonal*: the paper's descriptor "
        "with orders below n in two regions, 2 n values (the paper takes n = 24). "
        "*Discriminant*: 48 values learned on the known silhouettes from all moments of "
        "vertical order below n and horizontal order below n / 2; 8 values only at n = 4. Data "
        "as in [paper-noise.md](paper-noise.md).",
        "![recognition over order](paper-order.png)",
        *(
            f"## {name.capitalize()}\n\n" + curve_table(curve)
            for name, curve in curves.items()
        ),
    ], {"recognised_percent": curves, "seed": SEED})  # fmt: skip


def curve_table(curve: dict[str, Curve]) -> str:
    """A line for each order, a column for each noise and N."""
    header = ["n", *(f"{std} px, N = {n}" for std in curve for n in (1, 7))]
    orders = next(iter(curve.values()))
    return table(
        header,
        [[str(order), *(percent(v) for values in curve.values() for v in values[order])]
         for order in orders],
    )  # fmt: skip
