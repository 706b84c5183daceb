"""Sentences of a report: verdict, reasons, what to do next and the commands for it."""

from __future__ import annotations

import inspect
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.artefacts import BLURRED, ROUNDED, at_reversals, blurred_above
from hil.diagnosis.constants import ADEQUATE, CONFIDENT, HALF, WORTH
from hil.diagnosis.floor import NETWORK, TIME, function_sentences, known_to
from hil.diagnosis.heldout import BOTH, DIFFER, HELD_OUT_ADVICE, RIG_STATE
from hil.diagnosis.preconditions import GRAVITY_WARNING, LOST, NO_MASSES
from hil.diagnosis.residual_tests import (
    BENT,
    CHANGED,
    CUT_THERE,
    FIT_APART,
    STARTS,
    UNLIKE,
)
from hil.diagnosis.rules import OF_GEOMETRY
from hil.diagnosis.touches import PUSHED, TOUCHED
from hil.diagnosis.types import (
    EITHER,
    Finding,
    Indistinguishable,
    UnnamedCorrection,
    to_try,
)
from hil.diagnosis.verdict import (
    COMMON,
    HIGH_FLOOR,
    NO_GEOMETRY,
    REFUSED,
    matters,
    no_noise,
    not_white,
    only_there,
)
from hil.errors import ConfigError
from hil.excite.choose import NO_MOTION
from hil.identify.timing import RECORDED_LATE
from hil.models import catalogue
from hil.models.effect import Trait
from hil.models.model import Value, in_words, without_error
from hil.record.checks import OF_UNITS, SILENT
from hil.record.consistency import notes_of
from hil.report.data import COMPARED, Files, Material, readable_number, with_files

FloatArray = NDArray[np.float64]
#: Colour of the verdict's bar.
TONES = {
    "adequate": "#009E73",
    "missing-effect": "#0072B2",
    "ambiguous": "#E69F00",
    "unexplained": "#D55E00",
    "not-identifiable": "#D55E00",
    "bad-data": "#D55E00",
    COMPARED: "#56B4E9",
}
_ORIGIN = {
    "repeats": "The motion repeats itself. The noise floor is the difference between two passes "
    "of the same motion: no model of the motion can explain it.",
    "largest-model": "The motion does not repeat itself. The noise floor is the error of the "
    "largest model (every effect of the catalogue, and smooth functions of all positions and "
    "speeds) on blocks of time left out of its fit.",
}
#: Why a model has two errors.
BOTH_ERRORS = (
    "One-step and simulated errors differ. The one-step error takes the measured motion and "
    "predicts the effort at each instant. The simulated error takes the measured effort and "
    "predicts the motion: it integrates an error of the effort twice, so that slow and constant "
    "errors count most and fast ones hardly. An effect can therefore lower one error and not the "
    "other."
)
#: The same in one line, below a table of both.
TWO_ERRORS = (
    "error %: of the predicted effort, with the motion as measured. simulated %: of the position, "
    "simulated for {horizon:g} s with the measured efforts. Small errors of these add up in it, "
    "so it may be large even for an adequate model (docs/diagnosis.md)"
)
#: Codes of warnings that stand beside the verdict.
LEADING = (
    NO_GEOMETRY,
    RECORDED_LATE,
    LOST,
    GRAVITY_WARNING,
    DIFFER,
    BLURRED,
    ROUNDED,
    CHANGED,
    BENT,
    TOUCHED,
    PUSHED,
    HIGH_FLOOR,
    REFUSED,
    UNLIKE,
    COMMON,
)


# ------------------------------------------------------------ verdict


def meaning(effect: str) -> str:
    """One line on an effect, e.g. ``Friction that rises as the speed goes to zero``."""
    try:
        return (inspect.getdoc(type(catalogue.get(effect))) or "").split("\n")[0].rstrip(".")
    except ConfigError:
        return ""


def effect_on_joint(f: Finding) -> str:
    """E.g. ``stribeck on joint2``."""
    return f"{f.effect} on {f.joint}" if f.joint else f.effect


def percent(share: float) -> str:
    """A share in percent; one below a percent is not rounded to nothing."""
    return f"{100 * share:.0f}" if share >= 0.01 or share <= 0.0 else f"{100 * share:.1g}"


def listed(names: list[str]) -> str:
    """Names as a sentence lists them: a, b and c."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def remains(m: Material) -> str:
    """What all that was named leaves above the floor: how much, where and over what; or nothing.

    Each figure is said with the model that it belongs to.
    """
    ratios = m.ratio(m.explained)
    j = int(np.argmax(ratios))
    if m.verdict == "unexplained" and m.after.heldout.kind == "holdout" and ratios[j] <= ADEQUATE:
        return _fitted_alone(m)
    if ratios[j] <= ADEQUATE or m.verdict in ("adequate", "not-identifiable"):
        return ""
    lead = "With the named effects alone the" if m.findings else "The"
    still = "still " if m.findings else ""
    now, better = f"{ratios[j]:.2f}", f"{m.ratio(m.after)[j]:.2f}"
    of = "" if better == now else f", and {better} times with the corrections below"
    return (
        f"{lead} error of {m.joints[j]} is {still}{now} times the noise floor{of}"
        f"{_variables(m, j)}. No further effect passes every test."
    )


def _fitted_alone(m: Material) -> str:
    """That the held-out runs are at their noise floor, where the fitted ones are not at theirs."""
    ratios = m.after.result.rms / np.maximum(m.last.floor.rms, 1e-300)
    j = int(np.argmax(np.where(m.problem.holds, 0.0, ratios)))
    if ratios[j] <= ADEQUATE:
        return ""
    return (
        "The errors of the table are those of the held-out runs, which are at their noise floor. "
        f"On the fitted runs the error of {m.joints[j]} is {ratios[j]:.2f} times theirs"
        f"{_variables(m, j)}."
    )


def _variables(m: Material, j: int) -> str:
    """What the error of joint j depends on, as the end of a sentence; empty where none is known."""
    own = [s for s in m.network if s.joint == m.joints[j] and s.share >= WORTH]
    if not own:
        return ""
    most = max(own, key=lambda s: s.share)
    return f". A function of {most.words} could explain {percent(most.share)} % of what is above it"


def nameless(m: Material) -> list[str]:
    """Joints without a name whose fitted error is above the floor, of size, and no noise."""
    named = {f.felt for f in m.findings}
    told = {s.joint for s in m.network if s.share >= WORTH} - named
    over = matters(m.explained.result) & (m.ratio(m.explained) > ADEQUATE)
    return [name for name, felt in zip(m.joints, over, strict=True) if felt and name in told]


def rest(m: Material) -> str:
    """The sentence on joints where no effect explains what is missing, with a space before it."""
    more = nameless(m)
    if not more:
        return ""
    return f" On {listed(more)} more is missing, and no effect of the catalogue explains it."


def corrections(which: Sequence[UnnamedCorrection]) -> str:
    """What the improved model holds without a name; empty if nothing.

    Parameters
    ----------
    which : sequence of Correction
        In the order in which they were added.
    """
    stands = [c for c in which if Trait.GEOMETRY in catalogue.get(c.effect).traits]
    each = [
        f"{c.of} on {c.joint} ({c.relative_before:.2f} % -> {c.relative_after:.2f} %)"
        for c in which
        if c not in stands
    ]
    out = []
    if stands:
        joints = listed(list(dict.fromkeys(c.joint for c in stands)))
        out.append(
            f"Sums of sines and cosines stand for the missing robot description on {joints}."
        )
    if each:
        out.append(
            "The improved model also holds corrections without a name. They are functions of "
            f"{listed(each)}."
        )
    if out:
        out.append(
            "They predict motions like the recorded ones; they do not say what the cause is."
        )
    return " ".join(out)


def laws(which: Sequence[UnnamedCorrection], files: Files | None = None) -> list[str]:
    """Sentences on the laws that would do as much as the corrections of a joint, with commands.

    None where the corrections take less than half of what they found: any law would do as much.

    Parameters
    ----------
    which : sequence of Correction
        In the order in which they were added.
    files : Files, optional
        What was analysed, for the commands.
    """
    out = []
    begin = {c.joint: c.relative_before for c in reversed(which)}
    for c in {c.joint: c for c in which if c.alike}.values():
        if c.relative_after**2 > HALF * begin[c.joint] ** 2:
            continue
        first, *rest = c.alike
        more = f" (as would {listed(rest)})" if rest else ""
        text = (
            f"On {c.joint}, {first} would explain as much as the correction{more}. It did not pass "
            f"every test of a name. {to_try(first, c.joint)}"
        )
        out.append(with_files(text, files) if files else text)
    return out


def _worst(m: Material) -> int:
    """Joint whose first error stands farthest above its floor."""
    return int(m.ratio(m.before).argmax())


def _apart(m: Material) -> list[str]:
    """Sentences on held-out sessions that differ from the fitted ones."""
    return _said(m, DIFFER)


def unit_doubts(warnings: Sequence[tuple[str, str]]) -> list[str]:
    """What says that a value may be in another unit or of another sign, once for several runs.

    Parameters
    ----------
    warnings : sequence of (code, str)
        Of a diagnosis.
    """
    told: dict[tuple[str, str], list[str]] = {}
    for code, said in warnings:
        if code in OF_UNITS or code == SILENT:
            joint, _, what = said.partition(": ")
            told.setdefault((code, f"{joint} {what.split(' ')[0]}"), []).append(said)
    return [
        f"Check first: {runs[0]}{f' (in {len(runs)} sessions)' if len(runs) > 1 else ''}. "
        + ("What follows is of the other joints." if code == SILENT else WRONG_TOO)
        for (code, _), runs in told.items()
    ]


#: What a wrong unit or sign means for the answer.
WRONG_TOO = "If the recording is wrong here, the values below are wrong, too."


def silent_joints(warnings: Sequence[tuple[str, str]]) -> list[str]:
    """Joints whose effort never changes: a verdict says nothing of them."""
    return list(dict.fromkeys(n.joint for n in notes_of(warnings, SILENT)))


def _changed(m: Material) -> list[str]:
    """Sentences on values that changed at once."""
    return _said(m, CHANGED)


def _unlike_alone(m: Material) -> str:
    """Joints on which something else than noise is left, where nothing else is wrong."""
    at_floor = float(m.ratio(m.after).max()) <= ADEQUATE
    names = [n.joint for n in notes_of(m.warnings, UNLIKE)]
    alone = bool(names) and at_floor and not m.network
    return listed(list(dict.fromkeys(names))) if alone else ""


def _unlike(m: Material) -> list[str]:
    """Sentences on what is left at the floor and is no noise."""
    return _said(m, UNLIKE)


def _said(m: Material, which: str) -> list[str]:
    return [ended(text) for code, text in m.warnings if code == which]


def ended(text: str) -> str:
    """A sentence with the stop that it lacks; behind a command on a line of its own is none."""
    return text if "\n" in text or text.endswith(("?", ".", "!")) else f"{text}."


def tone(m: Material) -> str:
    """Colour of the verdict's bar."""
    return TONES["ambiguous" if m.verdict == "adequate" and _apart(m) else m.verdict]


def _undecided(findings: Sequence[Finding]) -> str:
    """What is sure of an ambiguous answer, and what is likely."""
    open_ = [f for f in findings if f.confidence < CONFIDENT] or list(findings)
    sure = [effect_on_joint(f) for f in findings if f not in open_]
    likely = listed([_likeliest(f) for f in open_])
    if not sure:
        return (
            f"An effect is missing, most likely {likely}. These data do not show which one it is."
        )
    return (
        f"The model lacks {listed(sure)}, and more, most likely {likely}. These data do not show "
        "what that is."
    )


def _likeliest(f: Finding) -> str:
    """An effect; behind its rivals where these weigh more."""
    weights = f.rival_weights if len(f.rival_weights) == len(f.rivals) else [0.0] * len(f.rivals)
    heavier = [r for r, w in zip(f.rivals, weights, strict=True) if w > f.confidence]
    return " or ".join([*heavier, effect_on_joint(f)])


def headline(m: Material) -> str:
    """The verdict in one sentence."""
    names = listed([effect_on_joint(f) for f in m.findings]) if m.findings else ""
    if m.verdict == "missing-effect":
        sure = [effect_on_joint(f) for f in m.findings if f.confidence >= CONFIDENT]
        perhaps = [effect_on_joint(f) for f in m.findings if f.confidence < CONFIDENT]
        lead = f"{len(sure)} effects: " if len(sure) > 1 else ""
        tail = f", and perhaps {listed(perhaps)}" if perhaps else ""
        return f"The model lacks {lead}{listed(sure)}{tail}.{rest(m)}"
    if m.verdict == "ambiguous" and of_geometry(m.findings):
        return (
            f"{NOT_LEARNT} may be what {names} {'stands' if len(m.findings) == 1 else 'stand'} for."
        )
    if m.verdict == "ambiguous":
        return _undecided(m.findings)
    if m.verdict == "adequate" and _apart(m):
        return "The model is adequate for the fitted data, but not for the held-out data."
    if m.verdict == "adequate":
        errors = dict(zip(m.joints, m.ratio(m.after).tolist(), strict=True))
        most = max(errors.values())
        said = explains(blurred_above(m.warnings, errors), "it", most, not_white(m.warnings))
        return f"The model is adequate: {said}"
    if m.verdict == "unexplained" and _undescribed(m):
        return UNDESCRIBED
    if m.verdict == "unexplained":
        if size := no_noise(m.warnings):
            return (
                f"What the model does not explain is a large part of the effort, and no sensor "
                f"noise: {size}. No effect of the catalogue explains it."
            )
        joint = _open(m)
        if only_there(m.after, m.last, m.floor):
            which = "The model" if m.after is m.before else "The improved model"
            return f"{which} explains the fitted data, but not {joint} in the held-out data."
        if at_reversals(m.explained, m.last, m.floor):
            return AT_REVERSALS
        change = next((c for c in m.last.changes if c.joint == joint and c.share > HALF), None)
        if change:
            what = "a value changes within a run" if change.at else "the runs differ"
            return f"On {joint} {what}: {change.subject} explains most of the error."
        if strange := _unlike_alone(m):
            return (
                f"All joints are at the noise floor, but the remaining error of {strange} is not "
                "noise."
            )
        return f"An effect is missing on {joint}; none of the catalogue passes every test."
    if m.verdict == "not-identifiable":
        return "Nothing can be concluded from these data, neither for nor against the model."
    if m.verdict == "bad-data":
        return "The recording or the robot description is faulty; no fit makes sense."
    j = _worst(m)
    ratio = float(m.ratio(m.before)[j])
    tail = "all joints are at the noise floor" if ratio <= 1.1 else f"{m.joints[j]} is worst"
    return f"Held-out error is up to {ratio:.2f} times the noise floor: {tail}."


def _open(m: Material) -> str:
    """The joint that an unexplained answer is about: the worst now, else a withheld name's."""
    ratios = m.ratio(m.explained)
    if ratios.max() <= ADEQUATE:
        return m.joints[m.concerned(1)[0]]
    return m.joints[int(np.argmax(ratios))]


#: Verdict where what is left is mostly reversals that the filter of the positions blurs.
AT_REVERSALS = (
    "The error is above the noise floor, but most of it lies at reversals that the position filter "
    "blurs. The data do not show a missing effect."
)

#: Verdict where free functions for the missing description are all that was added.
UNDESCRIBED = (
    "The robot description is missing, and free functions replace it. The data do not show whether "
    "an effect is missing as well."
)

#: Verdict where names may stand for the missing description; the names follow.
NOT_LEARNT = (
    "The robot description is missing, and free functions in its place do not explain the data. "
    "Gravity or the coupling of the joints"
)


def of_geometry(findings: Sequence[Finding]) -> bool:
    """Whether names are doubtful because the robot description is missing, and only so."""
    doubted = [f for f in findings if f.confidence < CONFIDENT]
    return bool(doubted) and all(f.reason.startswith(OF_GEOMETRY) for f in doubted)


def undescribed(
    verdict: str, warnings: Sequence[tuple[str, str]], corrections_: Sequence[UnnamedCorrection]
) -> bool:
    """Whether all that the data ask for is the description of the robot."""
    stand = all(Trait.GEOMETRY in catalogue.get(c.effect).traits for c in corrections_)
    lacks = any(code == NO_GEOMETRY for code, _ in warnings)
    return verdict == "unexplained" and lacks and bool(corrections_) and stand


def _undescribed(m: Material) -> bool:
    doubted = all(f.confidence == 0.0 for f in m.partial)  # explains too little to be one
    return undescribed(m.verdict, m.warnings, m.corrections) and doubted


def explains(blurred: bool, model: str, ratio: float = 1.0, floor: str = "") -> str:
    """What an adequate model explains, whether or not something leaves an error above its floor.

    Parameters
    ----------
    blurred : bool
        Whether reversals do.
    model : str
        What to call the model.
    ratio : float
        Largest error of a joint over its noise floor.
    floor : str
        What is said of a noise floor that no noise of the efforts makes; empty where one does.
    """
    if floor:
        over = f"an error of up to {ratio:.2f} times the noise floor" if ratio > ADEQUATE else ""
        return (
            f"{model} leaves {over or 'an error at the noise floor'}, but {floor}. This does "
            "not show that nothing is missing: white noise of the efforts makes up less than half "
            "of the power of that floor."
        )
    if blurred:
        return (
            "the error above the noise floor is a filter artifact at reversals, not a missing "
            "effect."
        )
    if ratio > ADEQUATE:
        return (
            f"{model} leaves an error of up to {ratio:.2f} times the noise floor. Its part above "
            "the floor has no practical size or comes from the measurement."
        )
    return f"{model} explains the data down to the noise floor."


def details(m: Material, files: Files | None = None) -> list[str]:
    """Sentences below the headline: effect, confidence, error before and after, floor.

    Parameters
    ----------
    m : Material
        What is reported.
    files : Files, optional
        What was analysed, for the commands.
    """
    out = (
        (unit_doubts(m.warnings) if m.rungs and m.verdict != "not-identifiable" else [])
        + _said(m, NO_GEOMETRY)
        + _said(m, RECORDED_LATE)
        + _said(m, TOUCHED)
        + _said(m, PUSHED)
        + _said(m, HIGH_FLOOR)
        + _said(m, LOST)
        + _said(m, GRAVITY_WARNING)
        + [_finding(m, f) for f in m.findings]
    )
    out += _said(m, BLURRED) + _said(m, ROUNDED)
    out += _apart(m) + _changed(m) + _said(m, BENT) + _unlike(m) + _said(m, COMMON)
    for f in m.partial:
        out.append(
            f"Best partial explanation: {effect_on_joint(f)} ({_errors(m, f)}; it explains "
            f"{percent(f.excess_explained)} % of the squared error above the noise floor). It is "
            f"not named as the cause: {f.reason}."
        )
    if m.findings and (left := remains(m)):
        out.append(left)
    out += _said(m, REFUSED)
    out += [corrections(m.corrections)] if m.corrections else []
    out += laws(m.corrections, files)
    if m.verdict == "not-identifiable" or not m.rungs:
        out += [text for _, text in m.warnings]
    if m.rungs and not (m.findings or m.partial or m.verdict == "not-identifiable"):
        j = _worst(m)
        held, ratio = m.before.heldout, float(m.ratio(m.before)[j])
        out += [floor_says(m.beyond)] if m.verdict == "adequate" else []
        out += [f"{line[:1].upper()}{line[1:]}." for line in function_sentences(m.network)]
        out.append(
            f"Largest error relative to the noise floor: {m.joints[j]} with "
            f"{held.relative[j]:.2f} % of the "
            f"effort; noise floor {m.relative_floor(j):.2f} % (ratio {ratio:.2f})."
        )
    return out


def _finding(m: Material, f: Finding) -> str:
    sure = "" if f.confidence >= CONFIDENT else ", too low to name it as the cause"
    rivals = f" Rivals with this motion: {', '.join(f.weighed_rivals)}." if f.rivals else ""
    text, errors = meaning(f.effect), _errors(m, f)
    name = effect_on_joint(f)
    return (
        f"{name[:1].upper()}{name[1:]}{f': {text[:1].lower()}{text[1:]}' if text else ''}. "
        f"Confidence {_chance(f.confidence)}{sure}. {errors[:1].upper()}{errors[1:]}; this "
        f"explains {percent(f.excess_explained)} % of the squared error above the noise floor."
        f"{rivals}"
    )


def _chance(p: float) -> str:
    return "above 0.99" if p > 0.99 else f"{p:.2f}"


def _errors(m: Material, f: Finding) -> str:
    of = f"of {f.felt_on} " if f.felt_on else ""
    text = (
        f"held-out error {of}{f.relative_before:.2f} % before, {f.relative_after:.2f} % after "
        f"(standard error {f.se:.2g})"
    )
    if (joint := f.felt) in m.joints:
        text += f", noise floor {m.relative_floor(m.joints.index(str(joint))):.2f} %"
    return text


def origin(m: Material) -> str:
    """Where the noise floor comes from."""
    text = _ORIGIN.get(m.last.floor.method, m.last.floor.method)
    share = known_to(m.rungs[0].step.result)
    what = "force sensor" if m.external else "measured effort"
    return f"{text} The accuracy of the {what} ({100 * share:g} % of its rms) is added."


def floor_says(beyond: float | None) -> str:
    """What an error at the floor does not prove, and what any function could still explain."""
    text = (
        "An error at the noise floor is no proof of a complete model: the floor also contains what "
        "no candidate explains"
    )
    if beyond is None:
        return f"{text}."
    if beyond < 0.005:
        return f"{text}. No function of a joint's own position and speed would lower the error."
    return (
        f"{text}. A function of a joint's own position and speed would lower its error by "
        f"{100 * beyond:.2g} % at most."
    )


def cell(value: float, floor: float) -> str:
    """Error in percent with its multiple of the floor."""
    return f"{readable_number(value)} % ({floor:.2f} x)"


def value(name: str, v: Value, joints: tuple[str, ...] = ()) -> str:
    """A parameter, e.g. ``j2.stribeck.fs = 0.031 N m (standard error 0.0007)``."""
    text = f"{name} = {readable_number(v.value, 4)}" + ("" if v.unit == "1" else f" {v.unit}")
    said, why = in_words(name, v.value, joints), without_error(name, v)
    notes = [said] if said else []
    notes += [f"standard error {readable_number(v.stderr, 2)}"] if v.stderr == v.stderr else []
    notes += [f"no standard error: {why}"] if why else []
    return text + (f" ({'; '.join(notes)})" if notes else "")


AGAIN = "Diagnose again."
#: Before all else where a unit or a sign is doubted.
CHECK_FIRST = (
    "See each 'Check first' above. If it is right, correct the recording or the map, and diagnose "
    "again."
)
#: Before all else where it lacks: gravity and coupling look like changes and remainders, too.
DESCRIBE = (
    "Give the robot's description first (--robot ARM.urdf): gravity and the coupling of the joints "
    "look like changes and remainders as long as the model lacks them."
)
#: What to do with rivals, where no motion is known that separates them, and where one may.
WAIT = "Do not take one of the rivals for the cause."
WAIT_AND_RECORD = "Do not rely on one of the rivals yet; record the motion that separates them."
#: The step to which the commands belong.
ACCEPT = "Accept"
#: Where what is left acts by itself.
_ELSEWHERE = (
    "Record this joint at rest with its motor on. A disturbance that does not depend on the motion "
    "(supply, neighbouring machine, limit cycle of a loop, knock) shows there too: remove it first."
)
#: Where the masses that the data ask for are none.
_APART = (
    "Record the robot free of contact, or with the force on it measured; check that efforts, "
    "positions and the description belong together."
)
#: Code of the check of a recording's rate.
_RATE = "sample-rate"
#: Where what is left acts at low speed.
SLOWLY = "Record slow strokes with many starts and turns: they show friction at low speed."
#: Verdict -> what follows from it alone.
VERDICT_CONSEQUENCES = {
    "adequate": [
        "Use the model within the range of motion that was recorded.",
        "For use beyond this range, record faster, slower and wider motion.",
    ],
    "unexplained": [
        "See where the model fails ('hil compare' on the same files, or --report): the missing "
        "effect acts there.",
        "Record more motion there; if the cause is known, write it as an effect of "
        "your own (one file) and diagnose again.",
    ],
    "not-identifiable": [
        "Record again as the sentence above says. A fit of these data would be meaningless."
    ],
    "bad-data": [
        "Correct what is said above, in the map or in the robot description, and diagnose again.",
        "Where the recording itself is at fault, see what 'hil info' says of it; then repair, cut "
        "or repeat it.",
    ],
    COMPARED: ["Run 'hil diagnose' on the same files to learn which effect is missing."],
}


# ------------------------------------------------------------ what to do

#: Where several runs were fitted and what is left follows the time.
EACH_ALONE = (
    "Diagnose each run alone. The answer then gives the instant of what changes at another time in "
    "every run, such as a gain that is reset."
)


def _separating(s: Indistinguishable) -> str:
    """Which motion tells rivals apart, if one does."""
    names = " or ".join(s.effects)
    if s.experiment == EITHER:
        return (
            f"{names}: with the sizes found here, they predict the same for every motion that was "
            "tried. For predictions use either."
        )
    if not s.experiment.startswith(NO_MOTION):
        return f"{names}: record {s.experiment}." + (f"\n{s.command}" if s.command else "")
    return f"{names}: {NO_MOTION} tells them apart{s.experiment.removeprefix(NO_MOTION)}."


def _separable(s: Indistinguishable) -> bool:
    """Whether a motion of this robot tells rivals apart."""
    return s.experiment != EITHER and not s.experiment.startswith(NO_MOTION)


def _doubted(f: Finding) -> str:
    """A name that is not to be relied on, and why."""
    return f"Do not rely on {effect_on_joint(f)} yet: {f.reason}."


def _listed(s: Indistinguishable, findings: Sequence[Finding]) -> bool:
    """Whether a set holds a named effect and one of the rivals that the answer gives it."""
    of = set(s.effects)
    return any(f.effect in of and of & set(f.rivals) for f in findings)


def next_steps(m: Material) -> list[str]:
    """What to do now, in plain words; the rate of the recording where it is doubted."""
    slow = {text for code, text in m.warnings if code == _RATE and m.verdict != "adequate"}
    tail = " before you rely on a name." if m.findings else "."
    return [text + tail for text in sorted(slow)] + _steps(m)


def _steps(m: Material) -> list[str]:
    """What follows from the verdict."""
    named = {f.effect for f in m.findings}
    rivals = [s for s in m.sets if named & set(s.effects)]
    if m.verdict == "missing-effect":
        sure = [effect_on_joint(f) for f in m.findings if f.confidence >= CONFIDENT]
        steps = [f"{ACCEPT} {listed(sure)}; all parameters are fitted again."]
        steps += [
            f"Confirm {effect_on_joint(f)} on a new recording: {shown_by(f.effect)}."
            for f in m.findings
            if f.confidence >= CONFIDENT
        ]
        return steps + [_doubted(f) for f in m.findings if f.confidence < CONFIDENT]
    if _undescribed(m) or (m.verdict == "ambiguous" and of_geometry(m.findings)):
        return [DESCRIBE, AGAIN]
    if m.verdict in ("adequate", "unexplained") and any(FIT_APART in x for x in _changed(m)):
        return _of_changes(m)
    if m.verdict in ("adequate", "unexplained") and _apart(m):
        what = (
            HELD_OUT_ADVICE
            if any(n.kind == RIG_STATE for n in notes_of(m.warnings, DIFFER))
            else BOTH
        )
        return [f"{what}.", AGAIN]
    if m.verdict == "unexplained" and only_there(m.after, m.last, m.floor):
        return [f"{BOTH}: the fitted motion hardly shows what acts there.", AGAIN]
    if m.verdict == "unexplained" and _changed(m):
        return _of_changes(m)
    if m.verdict == "unexplained" and (
        _said(m, LOST) or any(NO_MASSES in text for text in _said(m, GRAVITY_WARNING))
    ):
        return [_APART, AGAIN]
    if m.verdict == "unexplained" and _unlike(m) and not m.network:
        slow = all(STARTS in text for text in _unlike(m))
        return [SLOWLY if slow else _ELSEWHERE, AGAIN]
    if m.verdict == "unexplained" and m.problem.runs > 1 and _changes_with_time(m):
        return [EACH_ALONE, *VERDICT_CONSEQUENCES[m.verdict]]
    if m.verdict == "ambiguous":
        # what the table does not list as a rival is not to be separated first
        some = [s for s in rivals if _listed(s, m.findings)]
        separating = [_separating(s) for s in some]
        wait = WAIT_AND_RECORD if not some or any(map(_separable, some)) else WAIT
        doubted = [_doubted(f) for f in m.findings if f.confidence < CONFIDENT and not f.rivals]
        among = any(f.rivals for f in m.findings)
        return [*([wait] if among else []), *separating[:3], *doubted]
    steps = list(VERDICT_CONSEQUENCES[m.verdict])
    silent = silent_joints(m.warnings)
    if m.verdict == "adequate" and silent:
        steps[0] = (
            f"Do not use the model of {listed(silent)}, whose effort was not recorded. Use that of "
            "the other joints within the range of motion that was recorded."
        )
    if any(code in OF_UNITS for code, _ in m.warnings):
        return [CHECK_FIRST, *(steps if m.verdict == "adequate" else [AGAIN])]
    return steps


def _changes_with_time(m: Material) -> bool:
    """Whether what is left on some joint follows the time more than anything else."""
    for joint in m.joints:
        own = [s for s in m.network if s.joint == joint and s.share >= WORTH]
        if own and max(own, key=lambda s: s.share).feature == NETWORK + TIME:
            return True
    return False


def _of_changes(m: Material) -> list[str]:
    """What to do where a value changed within a run, or from one to the next."""
    told = " ".join(_changed(m))
    return [*(f"{what}." for what in (CUT_THERE, FIT_APART) if what in told), AGAIN]


def shown_by(effect: str) -> str:
    """Motion that shows an effect."""
    try:
        return catalogue.get(effect).doc.shown_by
    except ConfigError:
        return "see the effect's own documentation"
