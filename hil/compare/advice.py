"""What to do after a verdict, in plain words."""

from __future__ import annotations

from hil.compare.ambiguity import CONFIDENT
from hil.compare.judge import only_there
from hil.compare.material import COMPARED, Material
from hil.compare.sessions import ADVICE, BOTH, SAID
from hil.compare.words import apart, changed, listed, unlike, where
from hil.errors import ConfigError
from hil.models import catalogue

AGAIN = "Diagnose again."
#: Where what is left acts by itself.
ELSEWHERE = (
    "Record this joint at rest with its motor on: what acts by itself (a supply, a neighbouring "
    "machine, a loop that hunts, a knock) is there, too; take it away there."
)
#: Verdict -> what follows from it alone.
FIXED = {
    "adequate": ["Use the model within the range of motion that was recorded.",
                 "To be sure beyond it, record faster, slower and wider motion."],
    "unexplained": ["See below where the model fails: there the missing physics sits.",
                    "Record more motion there; if the cause is known, write it as an effect of "
                    "your own (one file) and diagnose again."],
    "not-identifiable": ["Record again as the sentence above says; a fit of these data would "
                         "give numbers without meaning."],
    "bad-data": ["Run 'hil info' on the recording; mend, cut or repeat it."],
    COMPARED: ["Run 'hil diagnose' on the same files to learn which effect is missing."],
}  # fmt: skip


def next_steps(m: Material) -> list[str]:
    """What to do now, in plain words."""
    named = {f.effect for f in m.findings}
    rivals = [s for s in m.sets if named & set(s.effects)]
    motions = [f"{' or '.join(s.effects)}: record {s.experiment}." for s in rivals]
    if m.verdict == "missing-effect":
        sure = [where(f) for f in m.findings if f.confidence >= CONFIDENT]
        steps = [f"Accept {listed(sure)} as shown below; all parameters are fitted again."]
        steps += [
            f"Confirm {where(f)} on a new recording: {shown_by(f.effect)}." for f in m.findings
        ]
        return steps
    if m.verdict in ("adequate", "unexplained") and apart(m):
        what = ADVICE if any(SAID in x for x in apart(m)) else BOTH
        return [f"{what}.", AGAIN]
    if m.verdict == "unexplained" and only_there(m.after, m.last, m.floor):
        return [f"{BOTH}: what acts there, the fitted motion hardly shows.", AGAIN]
    if m.verdict == "unexplained" and changed(m):
        return ["Give what was recorded before and after that instant as two sessions.",
                AGAIN]  # fmt: skip
    if m.verdict == "unexplained" and unlike(m) and not m.network:
        return [ELSEWHERE, AGAIN]
    if m.verdict == "ambiguous":
        wait = "Do not add an effect yet; record the motion that separates the rivals."
        return [wait, *motions[:3]]
    return list(FIXED[m.verdict])


def shown_by(effect: str) -> str:
    """Motion that shows an effect."""
    try:
        return catalogue.get(effect).shown_by
    except ConfigError:
        return "see the effect's own documentation"
