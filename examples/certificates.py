"""A path with its proof: written, verified by code that shares nothing with the planner, refused if changed."""

import json

from safe_ompl import Box, CertificateError, Obstacle, Pose, Robot, SafeSetup, Scene, certificate, verify

scene = Scene((Obstacle("pillar", Box((0.15, 0.15, 1.0)), Pose((0.45, 0.0, 0.4)), weight=1.0),))
setup = SafeSetup(Robot.from_example("ur5"), scene)
setup.setConfigurations([0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0])
result = setup.plan("SafeRRTConnect", time=10.0, simplify=True)

text = json.dumps(certificate(result.path, setup.robot, scene, field=setup.field))
print(f"a certificate of {len(text) // 1024} kB carries robot, scene, path and proof")

found = verify(json.loads(text))  # anywhere, by anyone: nothing else is needed
print(f"verified: {'; '.join(found.claims)}")
print(f"it does not speak of: {', '.join((*found.not_claimed, *found.not_covered))}")

changed = json.loads(text)
changed["stretches"][0]["motion"]["coefficients"][0][1][0] += 0.01
try:
    verify(changed)
except CertificateError as refused:
    print(f"changed by 0.01 rad: {refused}")
