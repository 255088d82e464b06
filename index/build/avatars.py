"""Who walks through the simulation: the avatars of the index and those of the experiments."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from index.build.body import Avatar, Phenotype, make_avatar
from index.build.garments import dress, find_garments, read_garment

Wardrobe = tuple[str, ...]

# name, gender (0 male, 1 female), age (0.33 child, 0.67 young, 1 old), muscle, weight,
# height, proportions; then what the avatar wears.
INDEX_AVATARS: tuple[tuple[Phenotype, Wardrobe], ...] = (
    (Phenotype("f-young-slim", 1.0, 0.65, 0.45, 0.30, 0.38, 0.8),
     ("female_casualsuit01", "shoes01", "ponytail01")),
    (Phenotype("m-young-slim", 0.0, 0.65, 0.55, 0.30, 0.38, 0.7),
     ("male_casualsuit01", "shoes02", "short02")),
    (Phenotype("f-adult-average", 0.95, 0.75, 0.50, 0.50, 0.34, 0.5),
     ("female_elegantsuit01", "shoes04", "bob01")),
    (Phenotype("m-adult-average", 0.05, 0.75, 0.55, 0.50, 0.34, 0.5),
     ("male_elegantsuit01", "shoes05", "short01")),
    (Phenotype("f-adult-heavy", 0.95, 0.80, 0.45, 0.85, 0.34, 0.4),
     ("female_casualsuit01", "shoes06", "long01")),
    (Phenotype("m-adult-heavy", 0.05, 0.80, 0.50, 0.90, 0.36, 0.4),
     ("male_casualsuit03", "shoes01", "short02")),
    (Phenotype("f-athletic", 0.90, 0.67, 0.85, 0.45, 0.36, 0.9),
     ("female_sportsuit01", "shoes05", "ponytail01")),
    (Phenotype("m-athletic", 0.05, 0.67, 0.95, 0.55, 0.34, 0.9),
     ("male_casualsuit04", "shoes02", "afro01")),
    (Phenotype("f-tall", 1.0, 0.70, 0.50, 0.45, 0.52, 0.6),
     ("female_elegantsuit01", "shoes01", "long01")),
    (Phenotype("m-tall", 0.0, 0.70, 0.55, 0.50, 0.50, 0.6),
     ("male_elegantsuit01", "shoes04", "fedora")),
    (Phenotype("f-old", 0.95, 0.98, 0.35, 0.60, 0.33, 0.4),
     ("female_casualsuit01", "shoes04", "bob02")),
    (Phenotype("m-old", 0.05, 0.98, 0.40, 0.60, 0.36, 0.4),
     ("male_worksuit01", "shoes06", "fedora_cocked")),
    (Phenotype("f-teenager", 0.95, 0.48, 0.45, 0.40, 0.48, 0.6),
     ("female_sportsuit01", "shoes02", "bob01")),
    (Phenotype("m-teenager", 0.05, 0.48, 0.50, 0.40, 0.48, 0.6),
     ("male_casualsuit02", "shoes05", "short03")),
    (Phenotype("m-broad-work", 0.0, 0.75, 0.80, 0.75, 0.30, 0.3),
     ("male_worksuit01", "shoes06", "short01")),
    (Phenotype("f-short", 0.95, 0.72, 0.50, 0.60, 0.24, 0.5),
     ("female_elegantsuit01", "shoes05", "short03")),
    (Phenotype("m-unclothed", 0.05, 0.70, 0.60, 0.45, 0.36, 0.6), ()),
    (Phenotype("f-unclothed", 0.95, 0.70, 0.50, 0.45, 0.38, 0.6), ()),
)  # fmt: skip

CALIBRATION_AVATARS: tuple[tuple[Phenotype, Wardrobe], ...] = (
    (Phenotype("calibration-f-slim", 0.97, 0.68, 0.55, 0.38, 0.42, 0.5),
     ("female_casualsuit01", "shoes02", "short02")),
    (Phenotype("calibration-m-slim", 0.03, 0.72, 0.60, 0.38, 0.33, 0.6),
     ("male_worksuit01", "shoes04", "short02")),
    (Phenotype("calibration-f-heavy", 0.92, 0.78, 0.50, 0.70, 0.36, 0.5),
     ("female_elegantsuit01", "shoes06", "ponytail01")),
    (Phenotype("calibration-m-heavy", 0.07, 0.82, 0.55, 0.80, 0.40, 0.5),
     ("male_casualsuit04", "shoes05", "short01")),
)  # fmt: skip
"""Bodies of the silhouettes that the confidence is fitted on."""

HELD_OUT_AVATARS: tuple[tuple[Phenotype, Wardrobe], ...] = (
    (Phenotype("held-f-slim", 0.95, 0.70, 0.40, 0.40, 0.40, 0.6),
     ("female_sportsuit01", "shoes06", "bob02")),
    (Phenotype("held-m-slim", 0.05, 0.70, 0.50, 0.42, 0.37, 0.5),
     ("male_casualsuit06", "shoes04", "short03")),
    (Phenotype("held-f-heavy", 0.90, 0.85, 0.55, 0.75, 0.31, 0.4),
     ("female_casualsuit01", "shoes05", "short02")),
    (Phenotype("held-m-heavy", 0.10, 0.85, 0.60, 0.72, 0.34, 0.4),
     ("male_casualsuit06", "shoes01", "fedora")),
)  # fmt: skip
"""Bodies that no index holds; ``male_casualsuit06`` is worn by nobody else."""

PAPER_AVATARS: tuple[tuple[Phenotype, Wardrobe], ...] = tuple(
    (phenotype, ()) for phenotype, _ in INDEX_AVATARS[2:6]
)
"""Two women and two men of different builds, unclothed, for the paper's experiments."""


def make_avatars(
    wanted: Iterable[tuple[Phenotype, Wardrobe]], garments: Path | None
) -> list[Avatar]:
    """Bodies in their clothes; unclothed where no garments folder is given.

    Raises
    ------
    GarmentError
        If a garment is missing or malformed.
    """
    files = find_garments(garments) if garments is not None else {}
    avatars = []
    for phenotype, wardrobe in wanted:
        avatar, base = make_avatar(phenotype)
        if files and wardrobe:
            avatar = dress(avatar, base, [read_garment(files[name]) for name in wardrobe])
        avatars.append(avatar)
    return avatars
