"""Bilateral teleoperation in theory: hybrid matrix, transparency, stability, force without sensors.

Notation per axis (thesis section 3.2): f_m, v_m at the master port, f_s, v_s at the slave port;
f_m is the operator's force ON the master, f_s the slave's force ON the environment, so that
f_m = +F_m and f_s = -F_s where F is what a sensor at the tip measures ON the robot.

    f_cm = c6 f_m - c2 f_s - c4 v_s - c8 v_m,      z_cm v_m = f_cm + f_m
    f_cs = c1 v_m + c3 f_m - c5 f_s - c7 v_s,      z_cs v_s = f_cs - f_s
"""
