"""Settings of the recurrent networks: shape, training, inference and class decoder."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.trackers.training.device import DeviceSettings
from gridtrack.trackers.training.labelled_scans import ClassWeights, LabelSettings

Gate = Literal["keep", "reset", "candidate"]
Precision = Literal["32-true", "bf16-mixed"]
EvidenceOption = Literal["state", "scan"]
GATES: tuple[Gate, ...] = ("keep", "reset", "candidate")


class ResolutionSettings(DeviceSettings):
    """Grids of any cell size and period, on any device."""

    resolution_input: bool = False
    """Whether cell size and step are inputs of the network, as in general weights; else it learns one of each."""
    step_s: float = Field(0.0, ge=0)
    """Duration of a step of the network, rounded to a whole number of steps a frame or frames a step. 0: that of a
    frame."""


class DilatedConvGRUSettings(ResolutionSettings):
    """The shape of the dilated ConvGRU; the defaults are from Ondruska et al. (2016).

    `static_gates`: the gates with a bias for each cell, the static memory; the others have one bias a channel.
    `dilated=false` makes all convolutions dense. `cell=plain` is h' = tanh(Wxh*x + Whh*h + bh), the candidate alone.
    """

    layers: int = Field(3, ge=1, le=8)
    channels: int = Field(16, ge=1, le=256)
    static_gates: tuple[Gate, ...] = GATES
    dilated: bool = True
    cell: Literal["gru", "plain"] = "gru"

    @property
    def gates(self) -> tuple[Gate, ...]:
        """The gates of a cell, in the order of its convolutions' channels."""
        return GATES if self.cell == "gru" else ("candidate",)


class DeepTrackingRNNSettings(ResolutionSettings):
    """The shape of the Deep Tracking RNN: version 1.1 of the published code, or 1.0 of the paper."""

    variant: Literal["code", "paper"] = "code"


class TrainingSettings(Settings):
    """Training on sequences of `repetitions` x (`observed_frames`, `blank_frames`); Adam, loss on the visible cells.

    The defaults are the scheme of Ondruska et al. (2016): 10 observed and 10 blank frames, twice. Horizons beyond
    `blank_frames` are never trained.
    """

    observed_frames: int = Field(10, ge=1)
    """Consecutive frames that are the network's input."""
    blank_frames: int = Field(10, ge=0)
    """Consecutive frames after them with empty input, which the network has to predict."""
    repetitions: int = Field(2, ge=1)
    """Number of such series in a sequence."""
    burn_in: int = Field(0, ge=0)
    """Observed frames before a sequence, without loss: it then starts from the state of a stream after some time."""
    time_reversal: bool = False
    """Augmentation: every second window, at random, is in reverse order of time."""
    moving_windows: bool = False
    """A window without motion is drawn again, a few times."""
    motion_weight: float = Field(0.0, ge=0)
    """Additional weight in the loss of visible cells near one that something entered, at the first update; it falls to
    zero until the last one, so that probabilities are calibrated for all cells."""
    shape_updates: int = Field(0, ge=0)
    """Number of first updates on windows of moving shapes alone, from which a network learns motion much faster."""
    shape_share: float = Field(0.0, ge=0, le=1)
    """Augmentation: share of the windows with moving shapes added in their visible cells."""
    superposition: bool = False
    """Augmentation: every second window, at random, is the superposition of two, with the moving objects of both."""
    updates: int = Field(4000, ge=1)
    batch: int = Field(2, ge=1)
    devices: int = Field(1, ge=1)
    """Number of accelerators of this machine, or processors if it has none, that share each batch equally."""
    learning_rate: float = Field(2e-3, gt=0)
    warm_up: int = Field(100, ge=0)
    """Updates over which the learning rate rises from zero; afterwards it falls to zero along a cosine."""
    unseen_weight: float = Field(0.0, ge=0)
    """Weight in the loss of a cell that no frame of the sequence sees, with the occupied rate of the recordings as its
    target, at a site its own rate; a visible cell has weight 1. With 0 forecasts are arbitrary where no beam came."""
    gradient_clip: float = Field(1.0, gt=0)
    weight_decay: float = Field(0.0, ge=0)
    validate_every: int = Field(250, ge=1)
    """Updates from one validation, and checkpoint, to the next."""
    precision: Literal["auto", "32-true", "bf16-mixed"] = "auto"
    """Precision of the convolutions: `auto` takes the faster one on this machine. States and gates are float32."""

    @property
    def length(self) -> int:
        """Frames in a training window: the burn-in and the sequence."""
        return self.burn_in + self.repetitions * (self.observed_frames + self.blank_frames)

    @property
    def last_observed(self) -> int:
        """Number of the last frame of a window that is an input of the network."""
        return max(frame for frame in range(self.length) if self.is_observed(frame))

    def is_observed(self, frame: int) -> bool:
        """Whether frame number `frame` of a window is an input of the network."""
        in_sequence = (frame - self.burn_in) % (self.observed_frames + self.blank_frames)
        return frame < self.burn_in or in_sequence < self.observed_frames


class InferenceSettings(DeviceSettings):
    """Settings of inference, which do not depend on training."""

    inference: Literal["float32", "bfloat16"] = "float32"
    """Precision of the convolutions. bfloat16 is faster on a processor with instructions for it, else slower;
    it is for the processor only."""
    evidence: EvidenceOption = "scan"
    """Evidence for the classes of the cells that are occupied now: `state`, the latent state, as in the paper; `scan`,
    its product with a classifier of the scan, if the weights have this classifier."""


DECODER_SETTINGS = {
    "channels": "class_channels",
    "learning_rate": "class_learning_rate",
    "weight_decay": "class_weight_decay",
    "class_weights": "class_weights",
}
"""The settings of a classifier, and their names in TransferSettings."""


class TransferSettings(LabelSettings):
    """Stages of training: the network on visible cells, its class decoder on labelled scans, or both."""

    stage: Literal["both", "occupancy", "classes"] = "both"
    """`classes` adds a class decoder to existing weights; `both` adds it if the recording has classes."""
    class_layers: int = Field(2, ge=1, le=3)
    """Convolutions of the class decoder, with dilation 1, 2 and 4; one is the paper's linear decoder."""
    class_channels: int = Field(32, ge=1, le=256)
    """Channels of its hidden layers; these four settings are, unless set, the best on the validation stretch."""
    class_learning_rate: float = Field(1e-2, gt=0)
    class_weight_decay: float = Field(1e-2, ge=0)
    class_weights: ClassWeights = "inverse-frequency"
    """Weights of the classes in the loss of the class decoder; the paper's are inverse to their frequency."""

    decoded_layers: Literal["last", "all"] = "last"
    """The layers of the latent state that the class decoder reads; the paper's reads the last one."""

    @property
    def class_hidden(self) -> tuple[int, ...]:
        """Channels of every layer of the class decoder but the last."""
        return (self.class_channels,) * (self.class_layers - 1)

    @property
    def given_of_decoder(self) -> dict[str, Any]:
        """The settings of the class decoder that the user set, by their names in ClassifierSettings."""
        return {own: getattr(self, name) for own, name in DECODER_SETTINGS.items() if name in self.model_fields_set}


class DilatedConvGRUOptions(DilatedConvGRUSettings, TrainingSettings, TransferSettings, InferenceSettings):
    """Shape, training and inference of the dilated ConvGRU and its class decoder."""


class DeepTrackingRNNOptions(DeepTrackingRNNSettings, TrainingSettings):
    """Shape and training of the Deep Tracking RNN."""
