"""Make a file like those that are published: a model alone, which takes two colour images and gives disparities."""

import torch
from stereo_net import AROUND, StereoNet
from torch import nn


class Published(nn.Module):
    """Colours of 0 .. 1, `[1, 3, rows, columns]`, to disparities in pixels, `[1, rows, columns]`."""

    def __init__(self) -> None:
        super().__init__()
        self.net = StereoNet()
        self.net.load_state_dict(torch.load("stereo_net.pt", weights_only=True))
        self.luma = nn.Parameter(torch.tensor([0.299, 0.587, 0.114]).view(1, 3, 1, 1))

    def forward(self, left: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
        """The disparities; black is where there is no image."""
        grey = [255 * (self.luma * each).sum(1, keepdim=True) for each in (left, right)]
        first, second = (torch.cat([each, (each > 0).to(each.dtype)], dim=1) for each in grey)
        return self.net(first, second)[0]


example = torch.rand(2, 1, 3, AROUND, AROUND // 2)
with torch.inference_mode():
    torch.jit.trace(Published().eval(), (example[0], example[1])).save("model.pt")
