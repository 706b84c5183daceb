"""Designs for the tests of the theory."""

from hypothesis import strategies as st

from hil.teleop.architecture import Design, MotionTerm, RobotImpedance

gain = st.floats(-2, 2)
positive = st.floats(0.05, 3)


def terms(stiff=400.0):
    return st.builds(MotionTerm, st.floats(-stiff, stiff), st.floats(-20, 20), st.floats(-0.2, 0.2))


def robots():
    return st.builds(RobotImpedance, positive, st.floats(0, 2))


def anchor():
    return Design(
        c1=MotionTerm(210, 14),
        c2=0.4,
        c3=0.1,
        c4=MotionTerm(-180, -12),
        c5=0.1,
        c7=MotionTerm(240, 16),
        c8=MotionTerm(240, 16),
        master=RobotImpedance(0.3),
        slave=RobotImpedance(0.3),
        name="anchor",
    )


def designs():
    return st.builds(Design, c1=terms(), c2=gain, c3=gain, c4=terms(), c5=gain, c6=gain,
                     c7=terms(), c8=terms(), master=robots(), slave=robots())  # fmt: skip
