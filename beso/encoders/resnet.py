"""ResNet-18 (He et al. 2016) without its classifier.

Parameters have torchvision's names, so that published weights load.
"""

import math
from typing import Final, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from beso.config import require

FEATURES: Final = 512
WIDTHS: Final = {64: (1, 1), 32: (1, 2), 16: (2, 2), 8: (2, 4)}  # parts of the picture (rows, columns) pooled apart
BLOCKS: Final = 2  # a stage
SIDE: Final = 8  # rows and columns of the map that the head "pyramid" makes

Head = Literal["average", "pyramid"]


class BasicBlock(nn.Module):
    """Two 3x3 convolutions and a shortcut, which is a 1x1 convolution where the shape changes."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.downsample: nn.Module = nn.Identity()
        if stride != 1 or inputs != outputs:
            shortcut = nn.Conv2d(inputs, outputs, 1, stride, bias=False)
            self.downsample = nn.Sequential(shortcut, nn.BatchNorm2d(outputs))

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) -> (B, outputs, ceil(H / stride), ceil(W / stride))."""
        inner = functional.relu(self.bn1(self.conv1(x)))
        return functional.relu(self.bn2(self.conv2(inner)) + self.downsample(x))


class ResNet18(nn.Module):
    """The network without its classifier: 512 features of a picture.

    Args:
        width: channels of the first stage, 64 in the published network; each of the next three stages has twice as
            many as the one before.
        generator: initial weights are drawn from it as torchvision does (He et al. 2015, fan out).
        head: what makes features of the stages' maps. "average" is the published pooling; a narrower network pools
            parts of the picture apart (WIDTHS), so that it has 512 features too: channels of the last stage times
            parts. "pyramid" keeps where things are: a feature pyramid (Lin et al. 2017) of 8 channels, which adds up
            the four stages' maps from the coarsest to the finest, averaged to 8 x 8 places.

    Raises:
        ValueError: the width is not one of WIDTHS.
    """

    def __init__(self, width: int, generator: torch.Generator, head: Head = "average") -> None:
        super().__init__()
        check_width(width)
        self.parts = WIDTHS[width]
        self.conv1 = nn.Conv2d(3, width, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.layer1 = _stage(width, width, 1)
        self.layer2 = _stage(width, 2 * width, 2)
        self.layer3 = _stage(2 * width, 4 * width, 2)
        self.layer4 = _stage(4 * width, 8 * width, 2)
        with torch.no_grad():
            for module in self.modules():
                if isinstance(module, nn.Conv2d):
                    fan_out = module.out_channels * math.prod(module.kernel_size)
                    module.weight.normal_(0, math.sqrt(2 / fan_out), generator=generator)
        self.laterals = nn.ModuleList()
        if head == "pyramid":
            for inputs in (width, 2 * width, 4 * width, 8 * width):
                lateral = nn.Conv2d(inputs, FEATURES // SIDE**2, 1)
                nn.init.normal_(lateral.weight, 0, math.sqrt(1 / inputs), generator)
                nn.init.constant_(lateral.get_parameter("bias"), 0)
                self.laterals.append(lateral)

    def forward(self, pictures: Tensor) -> Tensor:
        """Features (B, 512) of pictures (B, 3, H, W) whose channels have been standardised."""
        x = functional.relu(self.bn1(self.conv1(pictures)))
        x = functional.max_pool2d(x, 3, stride=2, padding=1)
        maps = []
        for stage in (self.layer1, self.layer2, self.layer3, self.layer4):
            x = stage(x)
            maps.append(x)
        if not self.laterals:
            return functional.adaptive_avg_pool2d(x, self.parts).flatten(1)
        pyramid = self.laterals[-1](x)
        for lateral, finer in zip(self.laterals[-2::-1], maps[-2::-1], strict=True):
            pyramid = lateral(finer) + functional.interpolate(pyramid, size=finer.shape[-2:], mode="bilinear")
        return functional.adaptive_avg_pool2d(pyramid, SIDE).flatten(1)


def check_width(width: int) -> None:
    """Raise ValueError unless there is a network of this width."""
    require(width in WIDTHS, f"width = {width}: must be one of {', '.join(map(str, WIDTHS))}")


def _stage(inputs: int, outputs: int, stride: int) -> nn.Sequential:
    rest = [BasicBlock(outputs, outputs, 1) for _ in range(BLOCKS - 1)]
    return nn.Sequential(BasicBlock(inputs, outputs, stride), *rest)
