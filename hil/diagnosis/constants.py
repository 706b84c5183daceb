"""Every constant of the diagnosis that decides something, in one place.

Three parts: what decides the search, a name and the verdict; what the checks before, beside and
after the search ask for, each in one check; and how a recording is dealt into blocks.  Tolerances
of the arithmetic, sizes of bases and grids, and limits of memory stay where they are used.

Each line says what the constant decides, where it comes from, and what moves when it is halved or
doubled: measured where figures stand, else what follows from the use.  Those that were not set on
tuning plants alone say so: they were chosen while recordings or test plants were in sight, and are
to be set anew on tuning plants.
"""

from __future__ import annotations

# ------------------------------------------------- what decides search, name and verdict

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
#: Error over its floor up to which it may be right: what lies between `ADEQUATE` and this is
#: looked at by the tests of the residual.  Floor and error are each known to a tenth.  Half: none
#: is looked at; double: residuals of undoubted misses are described as noise.
NEAR_FLOOR = 1.25
#: An error above so many times what the largest model leaves is never adequate, whatever the floor
#: says.  Tuning plants: floors that follow the residual.  Half: adequate sessions fail; double:
#: floors of short runs pass for errors.
APART = 1.2
#: Share of the noise variance that an effect must account for to be a rival at all.  A twentieth
#: in the rms, which no floor is known to.  Half: longer sets; double: small rivals go unsaid.
MATERIAL = 0.10
#: Share of chi2 by which a rival's functional form is allowed to miss the truth (tempers the
#: confidence).  Engine before, tuning plants.  Half: weights nearer to 0 and 1, more wrong ones of
#: 0.99; double: right names of small effects fall below `CONFIDENT`.
TEMPER = 0.01
#: Cosine between projected columns from which two effects look the same.  A fifth of the gain is
#: then left between them.  Nearer to 1: pairs that no data separate are told apart by chance;
#: farther: effects that can be separated share a set.
SAME_COSINE = 0.98
#: Logarithm of a weight below which nobody asks what contains the candidate.  `RIVAL`, in logs.
LIKELY = -3.0
#: Share of a direction below which the base model hides it.  Half or double: single sessions with
#: a base model that nearly absorbs the effect.
HIDDEN_DIRECTION = 0.01
#: Only effects that the base absorbs by this share can be imitated from another joint, and only
#: if they explain about as much there.  Tuning plants.  Less: real second effects are
#: called echoes.
MIRROR, SIMILAR = 0.9, 0.5
#: Noise that comes back late through a controller, in units of what 1.1 floors leave.  Tuning
#: plants under control.  Half: lags get names; double: small lags go unnamed.
ECHO = 2.0
#: Shapes from which on the best of them is a pick, and the share of the residual it then needs.
#: Chance of the best of 24 at 1 % each.  Half: shadows of waves get names; double: weak ripple is
#: lost.
MANY_SHAPES, LITTLE = 24, 0.02
#: The same for a line over time: what is less leaves an error within `ADEQUATE` of the floor.
LINE_LEAST = 1 - 1 / ADEQUATE**2
#: Share of the excess that a line over time must account for by itself; or this share, if without
#: it the joint is within so much of its floor: a floor that is a twentieth too low is a third of
#: an excess of half a floor.  Tuning plants.  Less: lines of the drive's noise are called effects.
LINE_SHARE, LINE_MAJOR, LINE_MET = 0.8, 0.6, 1.06
#: Relative error of an order that is a multiple of another one, and the highest multiple: five
#: standard errors of an order over ten turns.  Double: neighbouring orders are taken for overtones.
WHOLE_ORDER, HIGHEST_MULTIPLE = 0.01, 9
#: Blocks, beside one for each coefficient, from which their scatter says anything: of three blocks
#: not even coefficients of ten standard errors are more than chance.  Half: offsets of short runs
#: get names; double: short recordings get none.
FEWEST_BLOCKS = 10
#: Spread of times, relative to their mean, within which lags of several joints are one cause: late
#: forms differ by as much.  Double: two causes are called one.
ONE_TIME = 0.2

# ---------------------------------------------------------- what single checks ask for

#: Share of the effort to which it is known, and of the force where that is explained: linearity of
#: amplifiers and DACs and the jitter of a command within its period; non-linearity and cross-talk
#: of strain gauges, where nothing is known of the sensor at hand (data sheets).  They bound the
#: floor from below.  Half: converter errors are *unexplained*; double: small laws go unnamed.
EFFORT_ACCURACY, SENSOR_ACCURACY = 0.003, 0.01
#: Share by which a finer resolution must lower the held-out error.  Above the spread of one place
#: where a joint lingers.  Half: finer tables without need; double: coarse ones that miss detents.
LEAST_FALL = 0.04
#: Gain of the measured external effort: fall of the held-out mean square error from which it is
#: determined, and how near to -1 it must be for a wrong sign, or to 1 for a gain error.  Half:
#: signs are taken for ratios; double: ratios for signs.
GAIN_FALL, GAIN_NEAR = 0.25, 0.35
#: Columns in the wrong order or of the wrong sign: relative error from which a fit is none, from
#: which columns are tried in another way, and of a joint that may be the other one of two [%].
#: Recordings of people who mixed them up have 30 to 100 %.  Half: tried in vain, which costs time.
HOPELESS, DOUBTFUL, OTHER_JOINT = 50.0, 12.0, 10.0
#: Share of the error that is left when the columns are put right, at most; and by how much more
#: than that the least error of any fit may be before it is tried.  Double: order and friction are
#: confused.
COLUMNS_RIGHT, HOPED = 1 / 3, 1.2
#: A contact law is undetermined when forward and reverse regression differ by this factor; rows
#: with this share of the deepest penetration are contact.  Double: laws of noise get names.
DISAGREEMENT, TOUCHING = 1.5, 0.02
#: Least rms speed, in units of its noise, that is motion; shortest recording from which effects are
#: named, all runs without the filter's edges [s].  Half: standstill and single strokes get names.
SLOWEST, SHORTEST_RECORDING = 4.0, 4.0
#: Times by which friction of a rigid-body engine turns early [s]: a third of the time constants
#: that engines have by default (0.02 s and less), to half of them.  Found with the test plants in
#: sight.  Half: joints that such an engine moves are unexplained; double: more laws are excused.
FRICTION_LEADS = (0.002, 0.005, 0.01)
#: Share of a law's gain that must be left beside a blurred sign: false names of clean axes with
#: exact dry friction left 0.01 to 0.09 of theirs, true ones 0.98 and more.
BESIDE_BLUR = 0.3
#: Share of the squared error above which a blur or a smoother is said to hold it: what leaves an
#: error within `ADEQUATE` of the floor.
BLUR_SAID = 0.17
#: Steps of an encoder from row to row below which it is coarse; share of a law's gain that
#: smoothing must leave to it: clean arms and axes behind encoders of 14 to 16 bits leave below
#: 0.07, springs and modes of half a floor above 0.14.
COARSE_COUNTS, BESIDE_SMOOTHER = 3.0, 0.10
#: Factor by which a change at an instant must explain more than the same law throughout.  Half:
#: laws that act in one place are called changes; double: small changes are called laws.
CHANGE_MORE = 1.1
#: Kurtosis, and its standard errors, below which a residual keeps to two sides: less than one of a
#: thousand joints with Gaussian noise of any colour.  Below the next one it is no wave either.
SWINGS, SWINGS_SURE, SWITCH = -0.6, -2.5, -1.6
#: The same above which it comes in bursts: a tenth of the time then holds more than half of its
#: square.  Noise of turning encoders reaches 0.9, starts and exact dry friction 3.  Above the last
#: one bursts are all that there is.
BURSTS, BURSTS_SURE, BURSTS_ALONE = 3.0, 5.0, 10.0
#: Share of the time that is called bursts, and their length [s]: words alone.
BURST_SHARE, BURST_LENGTH = 0.1, 0.25
#: Growth of the rms over a run that is worth a word, and the kurtosis it needs; fewer instants
#: tell nothing.
GROWS, UNEVEN, FEWEST_SAMPLES = 2.0, 1.0, 200
#: Strength of a place that says of an error within `NEAR_FLOOR` that it is not right, in standard
#: errors.  Half: one joint of ten is said to fail somewhere by chance.
PLAIN = 4.0
#: Two sessions differ: factor between their errors, beside any chance; paired standard errors by
#: which an error falls when fitted alone; standard errors between two fits' predictions, which
#: count noise alone.  Half: warm-up is called a change; double: a changed payload is not.
SESSIONS_DIFFER, FALL_DEVIATIONS, CERTAIN = 1.2, 3.0, 5.0
#: Factor between two sessions' own errors from which the larger one is looked at for itself, and
#: share of an effect's power below which the other session lacks it.
LOUDER, LACKS = 1.5, 0.25
#: Share of a difference, or of what stands above the noise, that one effect must account for to be
#: named or said.  Half: every difference gets a name.
ACCOUNTED = 0.7
#: Share that an unnamed function must explain to be worth a word.
SAID_FROM = 0.005
#: Share of time at standstill that is worth a note.
STILL = 0.05
#: Share of an effect's columns from which the base model is said to absorb it.
ABSORBED = 0.9999
#: Log odds below which a proposed motion is as good as none.
MOTION_ODDS = 1.0
#: What a motion has not shown (words of `hil diagnose`): share of the top speed that is low, and of
#: Coulomb friction that would be missed there; reversals; share of a joint's range, and of the
#: effort's rms by which a static load must change; shortest time in which something warms up [s].
LOW_SPEED, COULOMB_MISSED, TURNS, RANGE, LOAD, WARMING = 0.02, 0.10, 10, 0.5, 0.1, 60.0

# ------------------------------------------------------------------ blocks of a recording

#: Blocks of time into which a recording is dealt, at least and at most.  Fewer: coarse standard
#: errors; more: blocks shorter than the filter.
FEWEST, MOST = 24, 96
#: Length of a block in periods of the effort filter, and of the guard at each of its ends;
#: chosen with a short six-joint recording in sight, of which longer ones left too few blocks.
PERIODS, GUARD = 6.0, 0.5
#: Folds into which blocks are dealt.  Half: a fifth less data for each fit; double: twice the
#: time.
FOLDS = 8
#: Pieces of a recording on each of which a correction of the others must serve: a sign test at
#: 3 %.  Simulated arms, axes and foams, judged on other motions than they were fitted to.  Half:
#: corrections of slow disturbances pass; double: hardly any correction does.
PARTS = 5
#: Bins of position by which it is seen where a joint has been.  Half: extrapolation is
#: overlooked; double: more instants are not judged.
BINS = 12
