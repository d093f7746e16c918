"""One step of the law: a nominal, its projection, and the safety check.

`step` is the idea. `pairs`, `limits`, `motors` and `spheres` are constraints,
`joint_command` is a nominal.
"""
