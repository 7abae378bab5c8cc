"""How a recurrent network is trained; the defaults are the paper's scheme."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.trackers.label_settings import LabelSettings

Gate = Literal["keep", "reset", "candidate"]
GATES: tuple[Gate, ...] = ("keep", "reset", "candidate")


class DilatedConvGRUSettings(Settings):
    """The shape of the network; the defaults are the paper's, and each of the last three takes one of its claims away.

    `static_gates` are those whose bias is a map; the others have one bias a channel. `dilated=false` leaves all
    convolutions dense. `cell=plain` is h' = tanh(Wxh*x + Whh*h + bh), the candidate alone.
    """

    layers: int = Field(3, ge=1, le=8)
    channels: int = Field(16, ge=1, le=256)
    static_gates: tuple[Gate, ...] = GATES
    dilated: bool = True
    cell: Literal["gru", "plain"] = "gru"

    @property
    def gates(self) -> tuple[Gate, ...]:
        """What a cell computes, in the order of its convolutions' channels."""
        return GATES if self.cell == "gru" else ("candidate",)


class DeepTrackingRNNSettings(Settings):
    """The shape of the network: the published code's version 1.1, or the paper's 1.0."""

    variant: Literal["code", "paper"] = "code"


class TrainingSettings(Settings):
    """Sequences of `cycles` times `shown` frames given and `blank` frames withheld; Adam on the visible cells' loss.

    The paper: 10 shown, 10 blank, twice. What lies further ahead than `blank` frames is never trained.
    """

    shown: int = Field(10, ge=1)
    blank: int = Field(10, ge=0)
    cycles: int = Field(2, ge=1)
    burn_in: int = Field(0, ge=0)
    """Frames shown before a sequence, without loss: the state then starts as in a stream that has run for a while."""
    reverse: bool = False
    """Also train on windows that run backwards in time."""
    superpose: bool = False
    """Also train on two windows laid over one another, as if the movers of both had been there."""
    updates: int = Field(4000, ge=1)
    batch: int = Field(2, ge=1)
    learning_rate: float = Field(2e-3, gt=0)
    warm_up: int = Field(100, ge=0)
    """Updates over which the learning rate rises from zero; afterwards it falls to zero along a cosine."""
    gradient_clip: float = Field(1.0, gt=0)
    weight_decay: float = Field(0.0, ge=0)
    validate_every: int = Field(250, ge=1)
    """Updates from one validation, and checkpoint, to the next."""
    precision: Literal["32-true", "bf16-mixed"] = "bf16-mixed"
    """Of the convolutions; the latent state and the gates stay in float32."""

    @property
    def length(self) -> int:
        """Frames in a training window: the burn-in and the sequence."""
        return self.burn_in + self.cycles * (self.shown + self.blank)

    def is_shown(self, frame: int) -> bool:
        """Whether the network is given this frame of a window."""
        return frame < self.burn_in or (frame - self.burn_in) % (self.shown + self.blank) < self.shown


class InferenceSettings(Settings):
    """How a trained network follows a stream; no other training is needed for it."""

    inference: Literal["float32", "bfloat16"] = "float32"
    """Of the convolutions. bfloat16 is the faster one where the processor has instructions for it, slower elsewhere."""


class TransferSettings(LabelSettings):
    """What is trained: the network, on what is visible; the class decoder, on its latent state and labels; or both."""

    stage: Literal["both", "occupancy", "classes"] = "both"
    """`classes` adds a class decoder to the weights that are there; `both` where a recording has classes."""
    class_layers: int = Field(2, ge=1, le=3)
    """Convolutions of the class decoder, with dilation 1, 2 and 4; one is the paper's, linear."""
    class_channels: int = Field(32, ge=1, le=256)
    """Of its hidden layers; chosen by the validation stretch where not given."""

    @property
    def class_hidden(self) -> tuple[int, ...]:
        """Channels of every layer of the class decoder but the last."""
        return (self.class_channels,) * (self.class_layers - 1)


class DilatedConvGRUOptions(DilatedConvGRUSettings, TrainingSettings, TransferSettings, InferenceSettings):
    """Shape and training of the dilated ConvGRU, and of its class decoder, and how it follows a stream."""


class DeepTrackingRNNOptions(DeepTrackingRNNSettings, TrainingSettings):
    """Shape and training of the Deep Tracking RNN."""
