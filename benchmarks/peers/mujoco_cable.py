"""MuJoCo's cable: capsules or cylinders joined by ball joints, inextensible and unshearable.

echo | python benchmarks/peers/mujoco_cable.py --segments 40 --dt 2e-3
"""

import argparse

import common
import mujoco
import numpy as np
from common import BENDING_DAMPING, DENSITY, GRAVITY, LENGTH, RADIUS, SHEAR, YOUNG


def model(segments: int, dt: float):
    # A joint turns where a segment's length of rod bends: its damping is B / h.
    damping = BENDING_DAMPING * segments / LENGTH
    return mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <extension><plugin plugin="mujoco.elasticity.cable"/></extension>
  <option gravity="{-GRAVITY} 0 0" integrator="implicitfast" timestep="{dt}">
    <flag contact="disable"/>
  </option>
  <size memory="64M"/>
  <worldbody>
    <composite type="cable" curve="0 0 s" count="{segments + 1} 1 1" size="{LENGTH}"
               offset="0 0 0" initial="none" prefix="c">
      <plugin plugin="mujoco.elasticity.cable">
        <config key="twist" value="{SHEAR}"/>
        <config key="bend" value="{YOUNG}"/>
        <config key="flat" value="true"/>
      </plugin>
      <joint kind="main" damping="{damping}"/>
      <geom type="cylinder" size="{RADIUS}" density="{DENSITY}"/>
    </composite>
  </worldbody>
</mujoco>""")


def prepare(segments: int, dt: float):
    steps = common.steps_per_sample(dt)
    rod = model(segments, common.SAMPLE / steps)
    state = mujoco.MjData(rod)
    mujoco.mj_forward(rod, state)
    last = rod.nbody - 1
    turn = lambda: state.xmat[last].reshape(3, 3)
    end = turn().T @ (np.array([0, 0, LENGTH]) - state.xpos[last])
    bad = [mujoco.mjtWarning.mjWARN_BADQACC, mujoco.mjtWarning.mjWARN_BADQPOS]
    bad.append(mujoco.mjtWarning.mjWARN_BADQVEL)

    def simulate():
        mujoco.mj_resetData(rod, state)
        mujoco.mj_kinematics(rod, state)
        path = [state.xpos[last] + turn() @ end]
        for _ in range(common.SAMPLES):
            mujoco.mj_step(rod, state, steps)
            mujoco.mj_kinematics(rod, state)
            path.append(state.xpos[last] + turn() @ end)
            if any(state.warning[kind].number for kind in bad):
                return None
        return path

    return simulate


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--segments", type=int, required=True)
    parser.add_argument("--dt", type=float, required=True)
    options = parser.parse_args()
    common.serve(f"MuJoCo {mujoco.__version__}", lambda: prepare(options.segments, options.dt))
