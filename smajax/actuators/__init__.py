"""Actuators whose equations are not the five stages of a wire: flexural, soft bending, knee.

Each is an ``AbstractActuator``: it declares its parameters as a plant does, and computes metrics with units.
``flexural`` (dauksher2021) is built of ``bending_moment``, ``cantilever`` and the heat equation in ``cross_section``;
``soft_bending`` (hybrid_knee_ankle_orthosis) of ``elastica``, ``pseudo_rigid_body`` and ``cross_section``; ``knee``
(hybrid_knee_ankle_orthosis) of ``knee_parts`` and the coil and material of the plant. ``smajax.files.actuator_file``
reads and writes their rig.toml.
"""
