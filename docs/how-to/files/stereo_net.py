"""A small stereo network on rectified pairs, and the matcher that runs it. Needs PyTorch."""

import numpy as np
import torch
from torch import nn
from torch.nn import functional

AROUND = 360
"""Pixels once around the baseline: a degree each."""
TWICE = 20
"""Rows that are there on both sides of the seam, as half planes go around: more than the network sees of each pixel."""


class StereoNet(nn.Module):
    """Block matching to begin with, and what is learned on top: features, a filter of the costs, a refinement."""

    def __init__(self, disparities: int = 36, features: int = 12, groups: int = 4) -> None:
        super().__init__()
        self.disparities, self.groups = disparities, groups
        self.features = nn.Sequential(
            nn.Conv2d(2, features, 3, padding=1), nn.ReLU(), nn.Conv2d(features, features, 3, padding=1)
        )
        self.costs = nn.Sequential(
            nn.Conv3d(1 + groups, 8, 3, padding=1),
            nn.ReLU(),
            nn.Conv3d(8, 8, (1, 3, 3), padding=(0, 1, 1)),
            nn.ReLU(),
            nn.Conv3d(8, 8, (3, 1, 1), padding=(1, 0, 0)),
            nn.ReLU(),
            nn.Conv3d(8, 1, 3, padding=1),
        )
        self.refinement = nn.Sequential(
            nn.Conv2d(4, 16, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(16, 16, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(16, 1, 3, padding=1),
        )
        for last in (self.costs[-1], self.refinement[-1]):  # nothing is changed to begin with
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)

    def forward(self, left: torch.Tensor, right: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Disparity in pixels, the coarse one before it, and minus the variance of that; each `[n, rows, columns]`."""
        left, right = normalised(left), normalised(right)
        first, second = self.features(left), self.features(right)
        n, c, rows, columns = first.shape
        volume = []
        for shift in range(self.disparities):  # a point moves to the left, from view 1 to view 2
            moved, grey = (functional.pad(each, (shift, 0))[..., :columns] for each in (second, right))
            alike = (first * moved).view(n, self.groups, c // self.groups, rows, columns).mean(2)
            unlike = (left[:, :1] - grey[:, :1]).abs() + 2 * (1 - grey[:, 1:])  # and where view 2 sees nothing
            volume.append(functional.avg_pool2d(torch.cat([unlike, alike], dim=1), 2))
        volume = torch.stack(volume, dim=2)
        unlike = functional.avg_pool3d(volume[:, :1], (1, 3, 3), stride=1, padding=(0, 1, 1), count_include_pad=False)
        share = torch.softmax((self.costs(volume) - 50 * unlike).squeeze(1), dim=1)
        steps = torch.arange(self.disparities, dtype=share.dtype).view(1, -1, 1, 1)
        mean = (share * steps).sum(1, keepdim=True)
        variance = (share * (steps - mean) ** 2).sum(1, keepdim=True)
        coarse, variance = (functional.interpolate(each, left.shape[-2:], mode="bilinear") for each in (mean, variance))
        seen = torch.cat([left[:, :1], moved_back(right, coarse), coarse / 10], dim=1)
        fine = coarse + self.refinement(seen)
        return fine[:, 0], coarse[:, 0], -variance[:, 0]


def moved_back(right: torch.Tensor, disparity: torch.Tensor) -> torch.Tensor:
    """The second image as the first one would see it at these disparities."""
    rows, columns = right.shape[-2:]
    x = torch.arange(columns, dtype=right.dtype) - disparity[:, 0]
    y = torch.arange(rows, dtype=right.dtype)[:, None].expand_as(x)
    at = torch.stack([(2 * x + 1) / columns - 1, (2 * y + 1) / rows - 1], dim=-1)  # pixel centres, as it counts
    return functional.grid_sample(right, at, align_corners=False)


def normalised(image: torch.Tensor) -> torch.Tensor:
    """Grey levels less their mean in a square of 9 pixels, in units of 30; and the mask as a second channel."""
    grey, valid = image[:, :1], image[:, 1:]
    pool = nn.AvgPool2d(9, stride=1, padding=4)
    mean = pool(grey * valid) / pool(valid).clamp(min=1e-3)
    return torch.cat([(grey - mean) * valid / 30, valid], dim=1)


def tensors(views) -> list[torch.Tensor]:
    """Both images `[1, 2, rows, columns]`: grey levels, and where there is an image."""
    pairs = zip(views.images, views.valid, strict=True)
    return [torch.from_numpy(np.stack([image, valid.astype(np.float32)])[None]) for image, valid in pairs]


class Network:
    """The matcher: made once a worker, called with every pair."""

    def __init__(self, *, weights_file: str) -> None:
        self.net = StereoNet()
        self.net.load_state_dict(torch.load(weights_file, weights_only=True))
        self.net.eval()

    def __call__(self, pair, limits):
        """Disparities in pixels of the rectified image, where these are between the limits."""
        torch.set_num_threads(1)  # more of them add up in another order, to another last digit
        views = pair.rectified(AROUND)
        with torch.inference_mode():
            images = (torch.cat([each[..., -TWICE:, :], each, each[..., :TWICE, :]], dim=-2) for each in tensors(views))
            disparity, _, sharpness = (each[0, TWICE:-TWICE].double().numpy() for each in self.net(*images))
        step_deg = np.degrees(views.projection.step)
        far, near = views.disparity_deg(limits.d_max_m) / step_deg, views.disparity_deg(limits.d_min_m) / step_deg
        known = views.valid[0] & (near > far)
        disparity = np.where(known, np.clip(disparity, far, near), np.nan)
        return views.answer(disparity_px=disparity, confidence=np.where(known, sharpness, np.nan))
