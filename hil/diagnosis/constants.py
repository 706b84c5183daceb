"""Every number of the diagnosis that decides something, in one place.

What counts, and is counted by a test: levels, sizes and shares that an answer is held against; the
limits of what a sensor, a device or an engine does; and how a recording is dealt into blocks.  The
rest of the names are derived from them, and say how.  What does not count stays where it is used:
tolerances of the arithmetic, sizes of bases and grids, numbers of draws, and limits of memory.

Each line says what the number decides, where it comes from, and what moves when it is halved or
doubled, as far as that follows from its use; `hil bench diagnosis --halve` prints which answers do.
Those that were not set on tuning plants alone say so: they were chosen while recordings or test
plants were in sight, and are to be set anew on tuning plants.
"""

from __future__ import annotations

import math
from statistics import NormalDist

# ------------------------------------------------------------------------- beyond chance

#: Level of every test: over all candidates, of coefficients, of nested laws, of changes, of bands.
#: Convention.  Double: twice as many false names in sessions with nothing hidden, the smallest
#: effects a tenth smaller.
LEVEL = 0.01
#: Standard errors that one test at `LEVEL` asks for, one-sided: 2.33.
SURE = NormalDist().inv_cdf(1 - LEVEL)
#: The same for the largest of many that nobody counted, and for a difference beyond any doubt:
#: 4.65, one in half a million.
CERTAIN = 2 * SURE
#: Paired standard errors by which the held-out error must fall.  Normal tail, 7 % one-sided,
#: beside `LEVEL`.  Half: effects of a single stretch pass more easily; double: end stops are
#: lost.
BEYOND = 1.5
#: One standard error: from which a held-out error has risen or a rival does better, and the same
#: as `BEYOND` for what takes most of what is left: a stop or a play acts in a few stretches, which
#: is not chance.  The rule of one standard error (Breiman and others, Classification and
#: Regression Trees, 1984, 3.4.3).  Half: rungs are lost to chance; double: a ladder may rise a
#: little on one joint, and stops that are met five times are lost.
RISEN = 1.0
#: Events, e.g. reversals or blocks beside one for each coefficient, below which one odd one
#: decides, and the highest multiple of an order that is told; turns of a wave over the range from
#: which it is no inaccuracy of a smooth law.  Half: offsets of short runs get names, and fewer
#: words on what a motion has not shown; double: short recordings get no names, and ripples beside a
#: large weight none.
FEW = 10

# --------------------------------------------------------------------- what is worth a name

#: Practical size, as a share of the rms effort: what is less is neither named nor unexplained; it
#: bounds the floor from below.  Linearity of amplifiers, converters and torque sensors (data
#: sheets: 0.1 to 0.5 %), and the jitter of a command within its period.  Lowered from 1 % with the
#: test plants in sight.  Half: laws of a seventh of a percent, and converter errors are
#: *unexplained*; double: a third of the effects of 1.5 floors of the test plants, whose floors are
#: half a percent of the effort, go unnamed.
MATTERS = 0.003
#: Practical size of what has no sure name: less of the rms effort leaves a model adequate.
#: Convention.  Half: clean robots of sharp friction and coarse encoders are *unexplained*; double:
#: more of what the catalogue does not hold is *adequate*.
ALARMS = 0.01
#: The same of a measured force where that is explained: non-linearity and cross-talk of strain
#: gauges (data sheets).  Half: cross-talk is *unexplained*; double: small laws of contact go
#: unnamed.
SENSOR_ACCURACY = 0.01
#: Least fall of the held-out rms of a joint that is worth an effect or a blunter sign, and share of
#: a residual that is worth a place in its floor, or a word.  Below it the eye sees no difference.
#: Half: more small effects; double: effects of half a floor are lost.
WORTH = 0.03
#: Share of its own power by which a library law misses a real effect (one number for all): for a
#: second effect beside it, and for a rival's weight.  Tuning plants: residual of the true law
#: beside simulated physics of another form.  Half: more names for what a first law's form leaves;
#: double: second effects below a fortieth go unnamed, right names of small effects lose weight.
DISCREPANCY = 0.0125
#: How well a floor is known, a tenth as a size, the part of a run that is its beginning or end, and
#: how near to a unit a factor of lengths, or to another zero the first guess of one, must be.
#: Two floors by different ways, tuning plants.  Half: right answers become *unexplained*, and how a
#: run begins is told as a change; double: effects of half a floor are overlooked.
TENTH = 0.10
#: Error over the measured noise floor that counts as met.
ADEQUATE = 1 + TENTH
#: The same where floor and error are each known to a tenth: held-out runs against their own floor,
#: two sessions, and the largest model against its own residual.
NEAR_FLOOR = ADEQUATE**2
#: Share of a squared error that brings it from `ADEQUATE` to the floor.
FLOOR_SHARE = 1 - 1 / ADEQUATE**2

# ------------------------------------------------------------------------- shares of a whole

#: Share that may stay open where something explains the whole: of what can be explained, of what a
#: sensor or a filter does, of a difference of two sessions.  Tuning plants: right and wrong names
#: part between 0.22 and 0.29; raised for the verdict on the EMPS record: a recording set it.  Half:
#: right names are withheld; double: shadows get names.
OPEN = 0.3
#: The share that it leaves.
WHOLE = 1 - OPEN
#: Even odds: share from which a name is worth something, confidence from which one without rivals
#: stands, share of a named effect's effort that a correction may take, error over that of a law in
#: its place from which that is no rival, and over that beside which a floor was measured from which
#: it is measured again.  Half: shadows get names, and floors beside a large error stay; double: no
#: name stands that does not explain everything, and every model has a floor of its own.
HALF = 0.5
#: Share of what a name does by which a free function in its place must surely do better, so that
#: the name does not stand; spread of times, relative to their mean, within which they are one; and
#: share of the time that pushes may take.
#: From the engine before, on tuning plants and for another measure of the same.  Half: right names
#: fall; double: laws without a name keep a wrong one.
BEATEN = 0.2

#: What is little of a whole: of a cosine of one between projected columns, so that two effects look
#: the same and a fifth of the gain is left between them; of a direction that the base hides; of the
#: top speed, of the deepest contact; of what all parts gain by a correction that one part may lose.
#: Half: pairs that no data separate are told apart by chance;
#: double: effects that can be separated share a set.
LITTLE = 0.02
#: Cosine from which two effects look the same.
SAME_COSINE = 1 - LITTLE

# ------------------------------------------------------------------------ names and rivals

#: Weight from which another effect is a rival that the answer names, and below which a name with
#: rivals is none.  Convention.  Half: longer sets; double: sets lose the truth more often.
RIVAL = 0.05
#: Doubt up to which a name is one.  Odds of three to one.  Half: fewer names alone; double: more
#: of them wrong.
DOUBT = 0.25
#: Confidence from which a name is one.
CONFIDENT = 1 - DOUBT
#: Its log odds, below which a proposed motion is as good as none.
CONFIDENT_ODDS = math.log(CONFIDENT / DOUBT)
#: Allowance for the form of a law, of one and the same number of coefficients: so many times as
#: much where the data hardly see a difference, and so many times less where they see it well (more
#: coefficients, or forms of real drives).  Engine before, tuning plants.  Half or double:
#: confidences of sets.
ALLOWANCE = 8.0
#: Share of an effect's columns that the base model must leave.  Rounding of a fit of many
#: columns.  Half or double: single sessions with a base model that all but absorbs the effect.
UNABSORBED = 1e-4
#: Share that it absorbs then.
ABSORBED = 1 - UNABSORBED
#: Shapes from which on the best of them is a pick: it must then explain something.  Chance of the
#: best of 24 at 1 % each.  Half: shadows of waves get names; double: weak ripple is lost.
MANY_SHAPES = 24
#: Relative error of an order that is a multiple of another one: five standard errors of an order
#: over ten turns.  Double: neighbouring orders are taken for overtones.
WHOLE_ORDER = 0.01

# ---------------------------------------------------- what sensors, filters and engines do

#: Longest time by which friction of a rigid-body engine turns early [s]: half of the time constants
#: that engines have by default (0.02 s and less).  Found with the test plants in sight.  Half:
#: joints that such an engine moves are unexplained; double: more laws are excused.
LEAD = 0.01
#: Periods of the positions' cut-off for which their filter rounds a turn: of a step it leaves 4 %
#: then.  A sign that takes longer to turn is blunt by itself.  Half or double: nothing known moves;
#: four times: laws of the speed that a blunt sign stands for are called reversals.
RESPONSE = 1.0
#: Factor between forward and reverse regression from which a contact law is undetermined.  Half:
#: laws of soft objects behind noise get no name; double: laws of noise get names.
DISAGREEMENT = 1.5
#: What a law of a transmission explains, in units of what the noise of the positions makes of the
#: predicted effort: below it is noise.  Simulated machines: clean ones with coarse encoders reach
#: 0.95, resonances begin at 8.  Half: coarse encoders get springs; double: a resonance among such
#: noise goes unnamed.
STIRRED = 2.0
#: The same, above which no noise makes it, however smooth it looks: ten times in size, for noise is
#: known no better.  Half: a quiet encoder may get a spring; double: a play looks like a smoother.
UNSTIRRED = 100.0
#: Steps of an encoder from row to row below which it is coarse.  Clean arms and axes behind
#: encoders of 14 to 16 bits.  Half: noise of coarse encoders gets names; double: bursts and small
#: lags of fine ones are excused.
COARSE_COUNTS = 3.0
#: Shortest recording from which effects are named, all runs without the filter's edges [s].  Half:
#: single strokes get names; double: short recordings get none.
SHORTEST = 4.0
#: Kurtosis below which a residual keeps to two sides: between that of noise, 0, and that of a
#: wave, -1.5.  Half: noise is a wave in one joint of a thousand; double: waves in noise go unsaid.
SWINGS = -0.6
#: Kurtosis above which a residual comes in bursts: a tenth of the time then holds more than half of
#: its square.  Noise of turning encoders reaches 0.9, starts and exact dry friction 3.  Half: exact
#: friction is called bursts; double: single events go unsaid.
BURSTS = 3.0
#: The same from which bursts are all that there is.  Half: adequate sessions fail; double: events
#: that nobody modelled pass.
BURSTS_ALONE = 10.0
#: Shortest time in which something warms up [s]: words of what a motion has not shown.
WARMING = 60.0

# ------------------------------------------------------------------ blocks of a recording

#: Blocks of time into which a recording is dealt, at most.  Double: blocks shorter than the filter.
MOST = 96
#: Length of a block in periods of the effort filter; chosen with a short six-joint recording in
#: sight, of which longer ones left too few blocks.  Half: neighbours share noise; double: few
#: blocks.
PERIODS = 6.0
#: Length of the guard at each end of a block, in the same periods.  Half: filtered samples are on
#: both sides; double: a third of short blocks is lost.
GUARD = 0.5
#: Folds into which blocks are dealt.  Half: a fifth less data for each fit; double: twice the
#: time.
FOLDS = 8
#: Pieces of a recording on each of which a correction of the others must serve: a sign test at
#: 3 %.  Simulated arms, axes and foams, judged on other motions than they were fitted to.  Half:
#: corrections of slow disturbances pass; double: hardly any correction does.
PARTS = 5
#: Levels of effort by which whole runs are dealt where there are two of each: what holds between
#: runs of one level may not hold at the next.  Double: with eight runs and more, levels that lie
#: close to each other, which forgive more.
LEVELS = 2
#: Rise of a simulated error from which a model that predicts the effort better is no better
#: model, as a factor.  Judgement: what has no law must not cost the simulation.  Half (any rise):
#: corrections of noisy recordings are lost by chance; double: models that swing stay.
RUINED = 2.0
#: Blocks into which a recording is dealt, at least: three of a fold.  Half: coarse standard
#: errors; double: short recordings have blocks shorter than the filter.
FEWEST = 24
#: Bins of position by which it is seen where a joint has been.  Half: extrapolation is
#: overlooked; double: more instants are not judged.
BINS = 12
