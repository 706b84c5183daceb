"""One parameter of an effect: name, unit, bounds, and words for values that are codes."""

from __future__ import annotations

from dataclasses import dataclass

INF = float("inf")
#: Name of the shape parameter that holds another joint's number, counted from 1.
JOINT = "joint"
#: Words for a number of poles.
POLES = ((1.0, "one pole"), (2.0, "two poles"))


@dataclass(frozen=True)
class Param:
    """One parameter of an effect.

    Parameters
    ----------
    name : str
        Short name, e.g. ``"fc"``; in a model it is ``j2.coulomb.fc``.
    unit : str
        SI unit; ``{F}`` stands for N m or N, ``{x}`` for rad or m.
    text : str
        What it is.
    lower, upper : float
        Physical bounds.
    source : str
        Where equation or bounds come from.
    codes : tuple of (float, str)
        Words for some values, e.g. ``((1.0, "Dahl"),)``.
    choice : bool
        Whether it is no quantity at all: there is nothing between its values, and no error.
    size : bool
        Whether a shape value is a size (a time, a width, a frequency): one that is less than its
        standard error is not determined, and nothing is named by it.
    """

    name: str
    unit: str
    text: str
    lower: float = -INF
    upper: float = INF
    source: str = ""
    codes: tuple[tuple[float, str], ...] = ()
    choice: bool = False
    size: bool = False

    def words(self, value: float, joints: tuple[str, ...] = ()) -> str:
        """Words for a value; empty where the number says all.

        Parameters
        ----------
        value : float
            The value.
        joints : tuple of str
            Joints of the robot, where they are known.
        """
        if self.name == JOINT:
            k = int(value)
            return joints[k - 1] if 1 <= k <= len(joints) else f"joint number {k}"
        return next((text for code, text in self.codes if code == value), "")
