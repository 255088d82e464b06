"""Makers of poses from recorded ones of people on their feet.

The trunk is turned at the hips, legs are folded, bodies laid down.
"""

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from scripts.training.render.pose import Pose, about

Maker = Callable[[Pose, Generator], None]


def bend_over(pose: Pose, generator: Generator) -> None:
    """Turn the trunk forward at the hips, over straight or bent legs."""
    angle = np.deg2rad(generator.uniform(35, 120))
    twist = about(np.array([0.0, 1.0, 0.0]), np.deg2rad(generator.normal(0, 15)))
    if generator.random() < 0.5:
        knee = np.deg2rad(generator.uniform(0, 55))
        for side in (0, 1):
            pose.fold_leg(side, knee * generator.uniform(0.6, 1.1), knee * 0.4)
    pose.lean(float(angle), float(generator.uniform(0.5, 0.9)))
    pose.turn(pose.bones.trunk, twist)
    # Arms hang, reach to the ground or stay with the trunk.
    pose.turn_arms(float(angle * generator.choice([0.0, 0.6, 1.0, 1.3])), 0.3, generator)
    pose.turn(pose.bones.head, about(pose.aside, float(-angle * generator.uniform(0, 0.5))))


RIDERS = 0.1
"""Share of those who sit."""


def sit(pose: Pose, generator: Generator) -> None:
    """Sit on something, with any legs, on the ground with the legs stretched out, or on a cycle."""
    if generator.random() < RIDERS:
        ride(pose, generator)
        return
    on_ground = generator.random() < 0.25
    lean = np.deg2rad(generator.normal(-2, 16) if generator.random() < 0.75
                      else generator.uniform(-50, 45))  # fmt: skip
    alike = generator.random() < 0.6
    pose.support = "ground" if on_ground else "seat"
    if on_ground:
        lean = np.deg2rad(generator.normal(5, 18))
    elif generator.random() < 0.12:
        # To the ground, to shoes, onto the knees.
        lean = np.deg2rad(generator.uniform(45, 90))
    if generator.random() < (0.4 if on_ground else 0.06):
        _cross_legs(pose, generator)
    else:
        folds = [_seated_leg(on_ground, generator) for _ in range(2)]
        for side in (0, 1):
            thigh, shank, spread = folds[0 if alike else side]
            pose.fold_leg(side, thigh, shank, spread)
    pose.lean(float(lean), 0.7)
    turn = about(np.array([0.0, 1.0, 0.0]), np.deg2rad(generator.normal(0, 12)))
    pose.turn(pose.bones.trunk, turn)
    pose.turn_arms(float(np.deg2rad(generator.uniform(-10, 70))), 0.35, generator)
    if generator.random() < 0.5:
        pose.turn(pose.bones.head, about(pose.aside, float(np.deg2rad(generator.uniform(0, 45)))))


def ride(pose: Pose, generator: Generator) -> None:
    """Sit on a cycle, the hands at its bar: pedalling, or with both feet on rests."""
    pose.support = "cycle"
    pedals = generator.random() < 0.6
    crank = generator.uniform(0, 2 * np.pi)
    thigh, shank = generator.uniform(55, 95), generator.uniform(-20, 40)
    spread = float(np.deg2rad(generator.uniform(0, 8 if pedals else 22)))
    for side in (0, 1):
        if pedals:
            high = np.sin(crank + side * np.pi)
            thigh, shank = 50 + 28 * high, 12 + 22 * np.cos(crank + side * np.pi)
        pose.fold_leg(side, float(np.deg2rad(thigh)), float(np.deg2rad(shank)), spread)
    lean = np.deg2rad(generator.uniform(-3, 55 if pedals else 25))
    pose.lean(float(lean), 0.6)
    reach = float(lean + np.deg2rad(generator.uniform(35, 75)))
    pose.turn_arms(reach, 0.12, generator)
    pose.turn(pose.bones.head, about(pose.aside, float(-lean * generator.uniform(0, 0.8))))


def _cross_legs(pose: Pose, generator: Generator) -> None:
    """Thighs level and apart, shanks folded inward."""
    vertical = np.array([0.0, 1.0, 0.0])
    for side, sign in ((0, 1.0), (1, -1.0)):
        pose.fold_leg(side, float(np.deg2rad(generator.uniform(80, 110))), float(np.pi / 2))
        out, inward = np.deg2rad(generator.uniform([25, 35], [60, 80]))
        pose.turn(pose.bones.thighs[side], about(vertical, float(sign * out)))
        pose.turn(pose.bones.shanks[side], about(vertical, float(sign * inward)))


def _seated_leg(on_ground: bool, generator: Generator) -> tuple[float, float, float]:
    spread = generator.uniform(-5, 30)
    if on_ground:
        # Knees up, or legs stretched out ahead.
        up = generator.random()
        thigh = 90 + 50 * up
        shank = -88 + 100 * up
    else:
        thigh = generator.uniform(65, 105)
        shank = generator.choice([generator.uniform(-15, 25), generator.uniform(-65, -10)])
    return float(np.deg2rad(thigh)), float(np.deg2rad(shank)), float(np.deg2rad(spread))


def crouch_or_kneel(pose: Pose, generator: Generator) -> None:
    """Squat, or kneel on one knee or both, upright or on the heels."""
    way = generator.random()
    for side in (0, 1):
        spread = np.deg2rad(generator.uniform(0, 35))
        if way < 0.4:
            thigh, shank = generator.uniform(75, 135), generator.uniform(15, 55)
        elif way < 0.6 and side == 0:
            thigh, shank = generator.uniform(70, 105), generator.uniform(-5, 25)
        else:
            back = generator.uniform(0, 20) if way < 0.8 else generator.uniform(20, 75)
            thigh, shank = back, generator.uniform(80, 100)
        pose.fold_leg(side, float(np.deg2rad(thigh)), float(np.deg2rad(shank)), float(spread))
    lean = generator.uniform(5, 50) if way < 0.4 else generator.normal(12, 15)
    pose.lean(float(np.deg2rad(lean)), 0.6)
    pose.turn_arms(float(np.deg2rad(generator.uniform(0, 80))), 0.35, generator)


def go_on_all_fours(pose: Pose, generator: Generator) -> None:
    """On hands and knees, or hands and feet."""
    on_feet = generator.random() < 0.2
    for side in (0, 1):
        thigh = generator.normal(10, 15)
        shank = generator.uniform(0, 35) if on_feet else generator.uniform(80, 100)
        thigh += 30 if on_feet else 0
        pose.fold_leg(side, float(np.deg2rad(thigh)), float(np.deg2rad(shank)))
    trunk = np.deg2rad(generator.uniform(72, 102) + (15 if on_feet else 0))
    pose.lean(float(trunk), 0.85)
    pose.turn_arms(float(trunk + np.deg2rad(generator.normal(0, 12))), 0.15, generator)
    pose.turn(pose.bones.head, about(pose.aside, float(-np.deg2rad(generator.uniform(0, 60)))))


def lie(pose: Pose, generator: Generator) -> None:
    """Lie on the back, the belly, a side or between, legs drawn up or not, propped up or not."""
    if generator.random() < 0.5:
        drawn = np.deg2rad(generator.uniform(0, 110))
        # Mostly the feet rest as well.
        least = 0.5 if generator.random() < 0.7 else -0.9
        for side in (0, 1):
            thigh = drawn * generator.uniform(0.6, 1.2)
            pose.fold_leg(side, float(thigh), float(thigh * generator.uniform(least, 1.0)))
    if generator.random() < 0.3:
        pose.lean(float(np.deg2rad(generator.uniform(-15, 55))), 0.4)
    if generator.random() < 0.6:
        pose.spread_arms(np.deg2rad(generator.uniform(5, 165, 2)), 0.25, generator)
    else:
        pose.turn_arms(float(np.deg2rad(generator.uniform(-20, 150))), 0.5, generator)
    # What was up points backwards, turned about the long axis; then a slope.
    roll = generator.uniform(0, 2 * np.pi)
    if generator.random() < 0.6:
        roll = generator.choice([0.0, 0.5, 1.0, 1.5], p=[0.4, 0.2, 0.2, 0.2]) * np.pi
        roll += generator.normal(0, 0.25)
    onto_back = about(np.array([1.0, 0.0, 0.0]), -np.pi / 2)
    slope = about(np.array([1.0, 0.0, 0.0]), float(np.deg2rad(abs(generator.normal(0, 9)))))
    turn = slope @ onto_back @ about(np.array([0.0, 1.0, 0.0]), float(roll))
    pose.rotations = turn @ pose.rotations


def stand_on_one_leg(pose: Pose, generator: Generator) -> None:
    """A knee raised, a foot at the other knee, or a leg stretched ahead or behind."""
    pose.posture = "standing"
    side, way = int(generator.integers(2)), generator.random()
    if way < 0.35:
        out = generator.uniform(40, 85) * (1 if side == 0 else -1)
        back = out + generator.uniform(15, 50) * np.sign(out)
        pose.turn(pose.bones.thighs[side], about(pose.ahead, float(np.deg2rad(out))))
        pose.turn(pose.bones.shanks[side], about(pose.ahead, float(np.deg2rad(-back))))
    elif way < 0.7:
        thigh, shank = generator.uniform([40, -10], [115, 70])
        pose.fold_leg(side, float(np.deg2rad(thigh)), float(np.deg2rad(shank)))
    else:
        thigh = generator.choice([generator.uniform(35, 90), generator.uniform(-60, -20)])
        bend = generator.uniform(0, 30)
        pose.fold_leg(side, float(np.deg2rad(thigh)), float(np.deg2rad(bend - thigh)))
        if thigh < 0:
            pose.lean(float(np.deg2rad(generator.uniform(0, 30))), 0.6)
    _gesture(pose, generator)


def lunge(pose: Pose, generator: Generator) -> None:
    """One foot far ahead, its knee bent, the other leg straight behind."""
    pose.posture = "standing"
    side = int(generator.integers(2))
    thigh, shank = generator.uniform(40, 85), generator.normal(0, 8)
    # As low as the leg ahead.
    behind = np.arccos((np.cos(np.deg2rad(thigh)) + np.cos(np.deg2rad(shank))) / 2)
    bend = abs(generator.normal(0, 8))
    pose.fold_leg(side, float(np.deg2rad(thigh)), float(np.deg2rad(shank)))
    pose.fold_leg(1 - side, float(-behind), float(behind + np.deg2rad(bend)))
    pose.lean(float(np.deg2rad(generator.normal(8, 14))), 0.5)
    _gesture(pose, generator)


def fold_arms(pose: Pose, generator: Generator) -> None:
    """Arms before the chest, or the hands at the hips."""
    pose.posture = "standing"
    vertical = np.array([0.0, 1.0, 0.0])
    crossed = generator.random() < 0.6
    for side, sign in ((0, 1.0), (1, -1.0)):
        inward = np.deg2rad(generator.uniform(45, 80))
        if crossed:
            pose.turn(pose.bones.arms[side], about(pose.aside, -generator.uniform(0.1, 0.5)))
            pose.turn(pose.bones.forearms[side], about(pose.aside, -generator.uniform(1.2, 1.7)))
            pose.turn(pose.bones.forearms[side], about(vertical, -sign * inward))
        else:
            out = generator.uniform(0.5, 0.9)
            pose.turn(pose.bones.arms[side], about(pose.ahead, sign * out))
            pose.turn(pose.bones.forearms[side], about(pose.ahead, -sign * (out + inward)))


def squat_wide(pose: Pose, generator: Generator) -> None:
    """Squat with the knees far apart."""
    pose.posture = "crouching"
    thigh, spread = generator.uniform([50, 35], [100, 65])
    for side in (0, 1):
        shank = generator.uniform(-5, 25)
        pose.fold_leg(side, *np.deg2rad([thigh, shank, spread]).tolist())
    pose.lean(float(np.deg2rad(generator.uniform(0, 35))), 0.6)
    _gesture(pose, generator)


def plank(pose: Pose, generator: Generator) -> None:
    """A straight body on hands and feet, on the forearms, or on one hand and a side."""
    pose.posture = "all_fours"
    # An arm of .55 m under shoulders that are 1.4 m from the feet.
    slope = np.deg2rad(generator.normal(67, 5))
    if generator.random() < 0.5:
        low = generator.random() < 0.35
        pose.turn_arms(float(np.deg2rad(generator.normal(85, 8))), 0.12, generator)
        if low:
            for forearm in pose.bones.forearms:
                pose.turn(forearm, about(pose.aside, float(-np.deg2rad(generator.normal(85, 10)))))
            slope += np.deg2rad(12)
        pose.turn_all(pose.aside, float(slope))
        return
    side = int(generator.integers(2))
    sign = 1.0 if side == 0 else -1.0
    up = generator.uniform(60, 100) if generator.random() < 0.6 else generator.uniform(-5, 30)
    raised = {side: generator.normal(85, 8), 1 - side: up}
    for arm, angle in raised.items():
        out = np.deg2rad(angle) * (1 if arm == 0 else -1)
        pose.turn(pose.bones.arms[arm], about(pose.ahead, float(out)))
    pose.turn_all(pose.ahead, float(-sign * slope))


def lean_on_arm(pose: Pose, generator: Generator) -> None:
    """Sit on the ground, the trunk upon one arm, as people do who get up."""
    pose.posture = "sitting"
    for side in (0, 1):
        pose.fold_leg(side, *_seated_leg(True, generator))
    side = int(generator.integers(2))
    sign = 1.0 if side == 0 else -1.0
    lean = float(np.deg2rad(generator.uniform(15, 40)))
    pose.lean(float(np.deg2rad(generator.normal(-10, 12))), 0.7)
    pose.turn(pose.bones.trunk, about(pose.ahead, -sign * lean))
    out = sign * (lean + generator.uniform(0.2, 0.7))
    pose.turn(pose.bones.arms[side], about(pose.ahead, out))
    pose.turn(pose.bones.arms[1 - side], about(pose.aside, -generator.uniform(0, 1.2)))


def bow(pose: Pose, generator: Generator) -> None:
    """Stand with the trunk level and the hands at the knees, as in prayer."""
    angle = np.deg2rad(generator.uniform(60, 95))
    pose.lean(float(angle), float(generator.uniform(0.6, 0.9)))
    pose.turn_arms(float(angle * generator.uniform(0.6, 0.95)), 0.1, generator)


def sit_on_heels(pose: Pose, generator: Generator) -> None:
    """Kneel on both knees with the seat on the heels, the hands on the thighs."""
    thigh = generator.uniform(58, 75)
    for side in (0, 1):
        spread = np.deg2rad(generator.uniform(0, 20))
        pose.fold_leg(side, float(np.deg2rad(thigh)), float(np.deg2rad(90)), float(spread))
    pose.lean(float(np.deg2rad(generator.normal(8, 8))), 0.6)
    pose.turn_arms(float(np.deg2rad(generator.uniform(15, 45))), 0.15, generator)


def prostrate(pose: Pose, generator: Generator) -> None:
    """Kneel with the forehead on the ground, the seat up or on the heels, the hands beside it."""
    thigh = np.deg2rad(generator.uniform(-5, 65))
    spread = float(np.deg2rad(generator.uniform(0, 20)))
    for side in (0, 1):
        pose.fold_leg(side, float(thigh), float(np.deg2rad(90)), spread)
    # Thighs of .42 m; from the hips to the forehead it is .7 m.
    trunk = np.pi / 2 + np.arcsin(np.clip((0.42 * np.cos(thigh) - 0.08) / 0.7, 0.0, 1.0))
    pose.lean(float(trunk), 0.75)
    pose.turn_arms(float(trunk + np.deg2rad(generator.uniform(60, 85))), 0.12, generator)
    pose.rest_on_knees_and_hands()


def bend_to_shoe(pose: Pose, generator: Generator) -> None:
    """Crouch, kneel on one knee or stand, the trunk over one foot and both hands at it."""
    way, side = generator.random(), int(generator.integers(2))
    if way < 0.4:
        lean = generator.uniform(25, 50)
        for leg in (0, 1):
            pose.fold_leg(leg, *np.deg2rad(generator.uniform([100, 20], [130, 45])).tolist())
    elif way < 0.8:
        lean = generator.uniform(40, 65)
        pose.fold_leg(side, *np.deg2rad(generator.uniform([80, -5], [110, 15])).tolist())
        pose.fold_leg(1 - side, *np.deg2rad(generator.uniform([0, 70], [35, 95])).tolist())
    else:
        lean = generator.uniform(95, 125)
        for leg in (0, 1):
            pose.fold_leg(leg, *np.deg2rad(generator.uniform([15, 5], [50, 25])).tolist())
    _reach_to_foot(pose, side, float(np.deg2rad(lean)), generator)


def bend_to_shoe_seated(pose: Pose, generator: Generator) -> None:
    """Sit on a seat, the trunk over one foot and both hands at it."""
    pose.support = "seat"
    side = int(generator.integers(2))
    for leg in (0, 1):
        pose.fold_leg(leg, *np.deg2rad(generator.uniform([75, -20], [100, 10])).tolist())
    _reach_to_foot(pose, side, float(np.deg2rad(generator.uniform(45, 70))), generator)


def _reach_to_foot(pose: Pose, side: int, lean: float, generator: Generator) -> None:
    """Lean forward and a little to a side, the arms towards a foot."""
    pose.lean(lean, 0.6)
    twist = np.deg2rad(generator.uniform(0, 20)) * (1 if side == 0 else -1)
    pose.turn(pose.bones.trunk, about(np.array([0.0, 1.0, 0.0]), float(twist)))
    pose.point_arms(int(pose.bones.shanks[side][1]))
    pose.turn_arms(0.0, 0.08, generator)


def kneel_on_hands(pose: Pose, generator: Generator) -> None:
    """On hands and knees, the shoulders a little higher than the hips."""
    for side in (0, 1):
        thigh = generator.normal(5, 12)
        pose.fold_leg(side, *np.deg2rad([thigh, 90, generator.uniform(0, 12)]).tolist())
    trunk = np.deg2rad(generator.uniform(62, 82))
    pose.lean(float(trunk), 0.85)
    pose.turn_arms(float(trunk + np.deg2rad(generator.uniform(0, 20))), 0.08, generator)
    pose.turn(pose.bones.head, about(pose.aside, float(-np.deg2rad(generator.uniform(0, 40)))))
    pose.rest_on_knees_and_hands()


def use_hands(pose: Pose, reach: float, generator: Generator) -> None:
    """Reach ahead or aside with one arm, by up to an angle; the other moves a little."""
    side = int(generator.integers(2))
    ahead, aside = reach * generator.uniform(-0.2, 1.0), reach * generator.normal(0, 0.4)
    turn = about(pose.ahead, float(aside)) @ about(pose.aside, float(-ahead))
    pose.turn(pose.bones.arms[side], turn)
    pose.turn_arms(0.0, 0.08, generator)


def _gesture(pose: Pose, generator: Generator) -> None:
    """Leave the arms, spread them, raise them ahead or above the head."""
    way = generator.random()
    if way < 0.3:
        pose.spread_arms(np.deg2rad(generator.uniform(50, 110, 2)), 0.15, generator)
    elif way < 0.5:
        pose.spread_arms(np.deg2rad(generator.uniform(145, 180, 2)), 0.15, generator)
    elif way < 0.7:
        pose.turn_arms(float(np.deg2rad(generator.uniform(40, 100))), 0.2, generator)


MAKERS: dict[str, Maker] = {
    "bending": bend_over, "crouching": crouch_or_kneel, "sitting": sit,
    "all_fours": go_on_all_fours, "lying": lie,
}  # fmt: skip
"""Poses that hardly any clip shows."""

UNRECORDED: dict[str, tuple[Maker, ...]] = {
    "standing": (stand_on_one_leg, lunge, fold_arms), "bending": (bow, bend_to_shoe),
    "crouching": (squat_wide, sit_on_heels, prostrate, bend_to_shoe),
    "all_fours": (plank, kneel_on_hands), "sitting": (lean_on_arm, bend_to_shoe_seated),
}  # fmt: skip
"""Poses that no clip shows."""

ACTIVITY_POSES: dict[str, Maker] = {
    "bow": bow, "on-heels": sit_on_heels, "prostrate": prostrate, "at-shoe": bend_to_shoe,
    "at-shoe-seated": bend_to_shoe_seated, "on-floor": kneel_on_hands,
}  # fmt: skip
"""Poses of daily life that are asked for by name, whatever their class."""
