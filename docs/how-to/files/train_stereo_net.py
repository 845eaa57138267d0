"""Train the network of stereo_net.py on a data set, `python train_stereo_net.py DIR`. Writes stereo_net.pt."""

import sys
import time

import numpy as np
import torch
from scipy import ndimage
from stereo_net import AROUND, StereoNet, tensors
from torch.nn.functional import smooth_l1_loss

import harness


def sample(pair):
    """A rectified pair, its true disparities in pixels, and where both views see the point."""
    grid = harness.Grid(width_px=AROUND, height_px=100)
    images = tuple(image.astype(np.float32) for image in pair.images)
    rectified = harness.Pair(images, pair.sensors, pair.motion, grid).rectified(AROUND)
    # The truth is on the pixels of image 1. Between those of one plane the inverse range is nearly linear; where the
    # four around a direction are not all in both views, or not all on one surface, nothing is learned.
    pixels, valid = harness.project(pair.sensors[0], rectified.directions)
    at = np.nan_to_num(pixels[..., ::-1], nan=-1.0).transpose(2, 0, 1)
    inverse = np.where(pair.state == 1, 1 / pair.range_m, np.nan)
    w = ndimage.map_coordinates(inverse, at, order=1, cval=np.nan)
    corners = [ndimage.shift(inverse, by, order=0, cval=np.nan) for by in ((0, 0), (0, -1), (-1, 0), (-1, -1))]
    steps = ndimage.map_coordinates(np.ptp(corners, axis=0), np.floor(at), order=0, cval=np.nan)
    point_2 = rectified.directions - w[..., None] * pair.motion.t_v1
    cross = np.cross(rectified.directions, point_2)
    angle = np.arctan2(np.linalg.norm(cross, axis=-1), (rectified.directions * point_2).sum(-1))
    disparity = angle / rectified.projection.step
    used = valid & rectified.valid[0] & np.isfinite(disparity) & (steps < 0.1 * w)
    return tensors(rectified), *map(torch.from_numpy, (np.nan_to_num(disparity).astype(np.float32), used))


def main(folder, epochs=2):
    """Fit the network to the pairs of a data set."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    begin = time.time()
    samples = [sample(pair) for pair in harness.open_dataset(folder).part("train")]
    print(f"{len(samples)} pairs read after {time.time() - begin:.0f} s", flush=True)
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
        losses = (smooth_l1_loss(each[0][used], disparity[used], beta=0.25) for each in (found, coarse))
        optimiser.zero_grad()
        sum(losses).backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        errors_px.append((found[0][used] - disparity[used]).abs().median().item())
        if step % 20 == 19:
            error_px, seconds = np.median(errors_px[-20:]), time.time() - begin
            print(f"step {step + 1} of {steps}: median error {error_px:.3f} px after {seconds:.0f} s", flush=True)
    torch.save(net.state_dict(), "stereo_net.pt")


if __name__ == "__main__":
    main(sys.argv[1])
