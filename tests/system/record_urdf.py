"""A robot of one joint."""

URDF = """<robot name="one"><link name="base"/><link name="arm"><inertial>
<origin xyz="0.1 0 0"/><mass value="0.5"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="9" velocity="9"/></joint></robot>"""
