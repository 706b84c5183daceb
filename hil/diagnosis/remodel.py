"""A fitted model made into another one: an effect less, another form, values or shapes that stay.

Nothing is fitted here; the search fits what comes out and judges it.
"""

from __future__ import annotations

from dataclasses import replace

from hil.diagnosis.attribution import as_use
from hil.diagnosis.types import Candidate
from hil.identify.context import renew
from hil.identify.design import Term, prefix
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.identify.shape_search import together
from hil.models import catalogue
from hil.models.effect import Trait
from hil.models.model import RobotModel, Use


def without(model: RobotModel, c: Candidate, problem: Problem) -> RobotModel:
    """A model without an effect that was added on one joint."""
    use = as_use(c, problem)
    rest = tuple(u for u in model.effects if _place(u) != _place(use))
    return replace(model, effects=rest)


def other_form(problem: Problem, result: FitResult, c: Candidate) -> RobotModel | None:
    """A fitted model with a found effect in the form that leaves least, sought with its sign.

    None where it has no other form, or none is found.
    """
    own = c.term.effect
    terms = {t.key: t for t in result.terms}
    term = terms.get(c.term.key)
    dry = [t for t in terms.values() if t.joint == c.joint and Trait.DRY in t.effect.traits]
    forms = {s[1:] for s in problem.grid(own, c.term.joint)}
    sized = bool(own.shape) and own.shape[0].size
    if term is None or not dry or not sized or own.scope.whole or len(forms) < 2:
        return None
    renew(result)
    found = together(problem, result.terms, result.sigma, term, dry[0])
    if found is None:
        return None
    model = result.model
    for t in found:
        model = _reshaped(model, t, problem)
    return model


def _reshaped(model: RobotModel, term: Term, problem: Problem) -> RobotModel:
    """A fitted model with other shape values of one of its terms."""
    head = prefix(term, problem.joints)
    values = {f"{head}.{p.name}": x for p, x in zip(term.effect.shape, term.shape, strict=True)}
    use = model.effects[term.use]
    new = {n: replace(v, value=values.get(n, v.value)) for n, v in use.values.items()}
    effects = list(model.effects)
    effects[term.use] = replace(use, values=new)
    return replace(model, effects=tuple(effects))


def _place(use: Use) -> tuple[str, tuple[str, ...], bool]:
    """What tells the uses of an effect in a model apart."""
    return use.type, use.joints, bool(use.options.get("per_run"))


#: Options of an effect whose values stay.
KEPT = {"fixed": True, "fixed_shape": True}


def kept(model: RobotModel) -> RobotModel:
    """A fitted model whose values stay; but those that every run has by itself."""
    effects = tuple(
        u if u.options.get("per_run") else replace(u, options={**u.options, **KEPT})
        for u in model.effects
    )
    return replace(model, effects=effects)


def uncorrected(model: RobotModel) -> RobotModel:
    """A fitted model without its corrections; what stands for a description stays."""
    table = catalogue.table()
    gone = {n for n, e in table.items() if e.traits & Trait.CORRECTION and not _stands(e.traits)}
    return replace(model, effects=tuple(u for u in model.effects if u.type not in gone))


def _stands(traits: Trait) -> bool:
    """Whether a correction stands for the robot's geometry."""
    return bool(traits & Trait.GEOMETRY)


def held(model: RobotModel) -> RobotModel:
    """A fitted model with its shapes held."""
    stay = {"fixed_shape": True}
    return replace(
        model, effects=tuple(replace(u, options={**u.options, **stay}) for u in model.effects)
    )


def freed(result: FitResult, named: FitResult) -> FitResult:
    """A fit with the effects and values of another one beside its own corrections."""
    own = {_place(u): u for u in named.model.effects}
    effects = tuple(own.get(_place(u), u) for u in result.model.effects)
    model = replace(result.model, effects=effects)
    return replace(result, model=model, values={**result.values, **named.values})
