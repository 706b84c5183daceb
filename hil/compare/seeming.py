"""Joints that are at their noise floor, and fail in places all the same.

A floor is what no model at hand goes below; where effects are missing that hide each other it holds
them, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hil.compare.localise import Region

CODE = "seeming"
#: Error over the floor that seems to be right, and strength of a place that says it is not.
NEAR, PLAIN = 1.25, 4.0


def seeming(
    ratio: Mapping[str, float], where: Mapping[str, Sequence[Region]]
) -> list[tuple[str, str]]:
    """Warnings (code, sentence) on joints that only seem to be right.

    Parameters
    ----------
    ratio : mapping of str to float
        Error over the noise floor, by joint.
    where : mapping of str to sequence of Region
        Where the model fails, by joint.
    """
    most = {j: max((r.strength for r in where.get(j, ())), default=0.0) for j in ratio}
    return [
        (
            CODE,
            f"{joint}: its error is near a floor that no model at hand goes below, and "
            f"{most[joint]:.1f} times its noise band in places: the floor holds something "
            "systematic; 'hil diagnose' measures it anew beside what it adds",
        )
        for joint, x in ratio.items()
        if x <= NEAR and most[joint] > PLAIN
    ]
