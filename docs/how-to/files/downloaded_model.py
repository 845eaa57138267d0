"""A matcher that is a model in a file, as it is published: no source of the network is needed. Needs PyTorch."""

import numpy as np
import torch


class Downloaded:
    """Made once a worker, called with every pair."""

    def __init__(self, *, model_file: str, around: int = 360) -> None:
        self.model = torch.jit.load(model_file).eval()
        self.around = around

    def __call__(self, pair, limits):
        """Disparities between the limits."""
        torch.set_num_threads(1)  # more of them add up in another order, to another last digit
        views = pair.rectified(self.around, colour=True)  # what the model was made for
        left, right = (torch.tensor(each).permute(2, 0, 1)[None] / 255 for each in views.images)
        with torch.inference_mode():
            disparity = self.model(left, right)[0].double().numpy()  # what it says
        step_deg = np.degrees(views.projection.step)
        far, near = views.disparity_deg(limits.d_max_m) / step_deg, views.disparity_deg(limits.d_min_m) / step_deg
        disparity = np.where(near > far, np.clip(disparity, far, near), np.nan)
        return views.answer(disparity_px=disparity)
