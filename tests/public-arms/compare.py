"""Every arm of every robot description in a folder, read by taktil and by Pinocchio.

An arm is the way from the base to a link without a child, or with fixed joints alone behind it,
with six to eight turning joints; what slides on the way is held. For each that both load, the
frame of the tip agrees to 1e-9 (m, and parts of the rotation) and the torque against gravity to
1e-6 N m, at random joint values. What taktil refuses is listed with its words. Ends with 1 where
they differ, or where taktil refuses what Pinocchio loads for a reason that is none of motion.
"""

import json
import pathlib
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pinocchio

FRAME_TOLERANCE = 1e-9
TORQUE_TOLERANCE_NM = 1e-6
# What taktil may say of a file that Pinocchio loads: reasons of motion.
REASONS = ("a mass of", "acceleration of 0", "mimics another joint", "more than ten turns")


def ways(file):
    """Tips of a file, each with its joints that turn and those that slide, base first."""
    joints = {}
    for joint in ElementTree.parse(file).getroot().findall("joint"):
        joints[joint.find("child").get("link")] = joint
    parents = {joint.find("parent").get("link") for joint in joints.values()}
    for tip in sorted(set(joints) - parents):
        turning, sliding, link = [], [], tip
        while link in joints:
            kind, name = joints[link].get("type"), joints[link].get("name")
            if kind in ("revolute", "continuous"):
                turning.insert(0, name)
            elif kind != "fixed":
                sliding.append(name)
            link = joints[link].find("parent").get("link")
        if len(turning) >= 6:
            yield tip, turning, sliding


def value(model, joint, at):
    """The part of a configuration in which a joint has a value."""
    return [np.cos(at), np.sin(at)] if model.joints[joint].nq == 2 else [at]


def configuration(model, places):
    """A configuration of the whole robot with these joints at these places."""
    q = pinocchio.neutral(model)
    for name, at in places.items():
        joint = model.getJointId(name)
        if joint < model.njoints and model.joints[joint].nq <= 2:
            part = value(model, joint, at)
            start = model.joints[joint].idx_q
            q[start:start + len(part)] = part
    return q


def compare(taktil, file, model, tip, turning, sliding, draws):
    """The worst differences of frame and torque, or what was said."""
    hold = [word for name in sliding for word in ("--hold", f"{name}=0")]
    spare = turning[:-7]
    for name in spare:
        joint = model.joints[model.getJointId(name)]
        # Where there are limits, between them.
        low, high = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        at = 0.0 if joint.nq == 2 or low <= 0.0 <= high else float(0.5 * (low + high))
        hold += ["--hold", f"{name}={at!r}"]
    moving = turning[len(spare):]
    worst_frame = worst_torque = 0.0
    for _ in range(3):
        q = draws.uniform(-1.0, 1.0, len(moving))
        at = ",".join(repr(float(x)) for x in q)
        said = subprocess.run([taktil, "arm", file, "--tip", tip, "--poses", "1", "--json",
                               *hold, f"--at={at}"], capture_output=True, text=True, check=False)
        if said.returncode == 2 or not said.stdout:
            return said.stderr.strip().splitlines()[0] if said.stderr else "no answer"
        answer = json.loads(said.stdout)
        assert answer["joints"] == moving, (answer["joints"], moving)
        held = {joint["name"]: joint["at"] for joint in answer["held"]}
        # What is held hangs on its joint in the whole robot as if it were welded.
        data = model.createData()
        full = configuration(model, {**held, **dict(zip(moving, q))})
        pinocchio.framesForwardKinematics(model, data, full)
        place = data.oMf[model.getFrameId(tip, pinocchio.FrameType.BODY)]
        torque = pinocchio.computeGeneralizedGravity(model, data, full)
        order = [model.joints[model.getJointId(name)].idx_v for name in moving]
        ours = answer["at"]
        rotation = np.array(ours["rotation_by_rows"]).reshape(3, 3)
        worst_frame = max(worst_frame, np.abs(place.translation - ours["position_m"]).max(),
                          np.abs(place.rotation - rotation).max())
        worst_torque = max(worst_torque, np.abs(torque[order] - ours["gravity_nm"]).max())
    return worst_frame, worst_torque


def main():
    taktil, folder = sys.argv[1:3]
    draws = np.random.default_rng(1)
    agreed = wrong = 0
    refused = {}
    for file in sorted(pathlib.Path(folder).rglob("*.urdf")):
        try:
            model = pinocchio.buildModelFromUrdf(str(file))
        except Exception as error:  # What Pinocchio refuses is no reference.
            print(f"{file.name}: Pinocchio refuses it: {error}")
            continue
        # Earth's acceleration as taktil takes it.
        model.gravity.linear = np.array([0.0, 0.0, -9.81])
        for tip, turning, sliding in ways(file):
            found = compare(taktil, str(file), model, tip, turning, sliding, draws)
            if isinstance(found, str):
                refused.setdefault(found, []).append(f"{file.name} {tip}")
                continue
            frame, torque = found
            if frame > FRAME_TOLERANCE or torque > TORQUE_TOLERANCE_NM:
                wrong += 1
                print(f"DIFFERS {file.name} {tip}: frame {frame:.1e}, torque {torque:.1e} N m")
            else:
                agreed += 1
    unfounded = 0
    for reason, where in sorted(refused.items()):
        founded = any(words in reason for words in REASONS)
        unfounded += not founded
        print(f"{'refused' if founded else 'REFUSED'} {len(where)} times: {reason} ({where[0]})")
    print(f"{agreed} arms agree, {wrong} differ, {sum(map(len, refused.values()))} are refused")
    sys.exit(1 if wrong or unfounded or not agreed else 0)


if __name__ == "__main__":
    main()
