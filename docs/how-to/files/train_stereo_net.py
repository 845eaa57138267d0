"""Train the network of stereo_net.py on pairs of random rooms, made here. Writes stereo_net.pt."""

import sys
import time

import numpy as np
import torch
from stereo_net import AROUND, StereoNet, tensors
from torch.nn.functional import smooth_l1_loss

import harness
from harness.simulation.truth import truth

SENSOR = harness.Sensor(camera={"width_px": 320, "height_px": 240, "focal_px": 307.06, "cx_px": 159.5, "cy_px": 119.5})
GRID = harness.Grid(width_px=360, height_px=100)


def texture(draws):
    """Photographs of gravel, grass or bricks, or noise of a random size and contrast."""
    tile_m = float(draws.uniform(2, 7))
    kind = draws.choice(["gravel", "grass", "brick", "noise", "noise"])
    if kind != "noise":
        return {"kind": "bundled", "name": str(kind), "tile_m": tile_m}
    seed, shortest_m = int(draws.integers(1000)), float(draws.uniform(0.04, 0.15))
    return {"kind": "noise", "seed": seed, "tile_m": tile_m, "shortest_m": shortest_m, "longest_m": 10 * shortest_m}


def room(draws):
    """A room with boxes in it, away from the middle."""
    size = draws.uniform([4, 4, 2.2], [9, 9, 5]).tolist()
    sides = {side: texture(draws) for side in ("x_min", "x_max", "y_min", "y_max", "bottom", "top")}
    objects = [{"kind": "box", "name": "room", "inward": True, "size_m": size, **sides}]
    for number in range(draws.integers(0, 6)):
        across, away = draws.uniform(0.2, 0.8), draws.uniform(1.3, 1.8)
        at = away * np.exp(1j * draws.uniform(-np.pi, np.pi))
        box = {"size_m": [across, draws.uniform(0.2, 0.8), draws.uniform(0.3, 2.0)], "yaw_deg": draws.uniform(0, 90)}
        box |= {"position_m": [at.real, at.imag, 0], "texture": texture(draws)}
        objects.append({"kind": "box", "name": f"box {number}", **box})
    return harness.load_scene({"name": "random", "objects": objects})


def sample(seed):
    """A rectified pair with noise, its true disparities in pixels, and where both views see the point."""
    draws = np.random.default_rng(seed)
    scene = room(draws)
    first = harness.Pose(position_m=(0, 0, float(draws.uniform(0.8, 1.4))), yaw_deg=float(draws.uniform(0, 360)))
    step = draws.uniform(0.15, 0.5) * np.exp(1j * draws.uniform(-np.pi, np.pi))
    position = np.add(first.position_m, [step.real, step.imag, draws.normal(0, 0.02)])
    second = harness.Pose(position_m=tuple(position.tolist()), yaw_deg=first.yaw_deg)
    images = []
    for pose in (first, second):
        at = {"position_m": pose.position_m, "yaw_deg": pose.yaw_deg}
        clean = harness.render(scene, sensor=SENSOR, samples=4, grid=GRID, **at).image
        noise = draws.normal(0, draws.uniform(0, 4), clean.shape)
        images.append(np.where(clean > 0, clean + noise, 0).astype(np.float32))
    pair = harness.Pair(tuple(images), (SENSOR, SENSOR), harness.relative_motion(first, second), GRID)
    rectified = pair.rectified(AROUND)
    there = truth(scene, first, rectified.directions, rectified.valid[0], pose_2=second, sensor_2=SENSOR)
    point = rectified.directions * there.range_m[..., None]
    towards_2 = point - pair.t_v1
    angle = np.arctan2(np.linalg.norm(np.cross(point, towards_2), axis=-1), (point * towards_2).sum(-1))
    disparity = np.nan_to_num(angle / rectified.projection.step).astype(np.float32)
    return tensors(rectified), torch.from_numpy(disparity), torch.from_numpy(there.visible.copy())


def main(pairs=100, epochs=2):
    """Make the pairs, and fit the network to them."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    begin = time.time()
    samples = []
    for seed in range(10 * pairs):
        try:
            samples.append(sample(seed))
        except harness.InputError:  # a view inside a box
            continue
        if len(samples) == pairs:
            break
    print(f"{len(samples)} pairs after {time.time() - begin:.0f} s", flush=True)
    net = StereoNet()
    optimiser = torch.optim.AdamW(net.parameters(), lr=1e-3)
    steps = epochs * len(samples)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 2e-3, total_steps=steps)
    order, errors_px = np.random.default_rng(0), []
    for step in range(steps):
        if step % len(samples) == 0:
            shuffled = order.permutation(len(samples))
        (left, right), disparity, visible = samples[shuffled[step % len(samples)]]
        used = visible & (disparity < net.disparities - 1)
        # A third of the rows at a time, at a random turn around the baseline: quicker, and no two steps are alike.
        turn, third = int(order.integers(AROUND)), AROUND // 3
        left, right = (torch.roll(each, turn, dims=-2)[..., :third, :] for each in (left, right))
        disparity, used = (torch.roll(each, turn, dims=0)[:third] for each in (disparity, used))
        if used.sum() < 1000:
            continue
        found, coarse, _ = net(left, right)
        losses_of = (smooth_l1_loss(each[0][used], disparity[used], beta=0.25) for each in (found, coarse))
        loss = sum(losses_of)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        errors_px.append((found[0][used] - disparity[used]).abs().median().item())
        if step % 20 == 19:
            error_px, seconds = np.median(errors_px[-20:]), time.time() - begin
            print(f"step {step + 1} of {steps}: median error {error_px:.3f} px after {seconds:.0f} s", flush=True)
    torch.save(net.state_dict(), "stereo_net.pt")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
