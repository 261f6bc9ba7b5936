"""
What the confidence image means.

255 means sure. At value c the model expects an error of -0.05 log(c / 255) / log 4: the absolute
difference to the truth, averaged over the colour channels, as a share of full brightness. So 255
is no error, 128 is 0.025 (6 of 255), 64 is 0.05, and 0 is 0.2 or more. The expectation is a
Laplace scale that the network predicts, times one factor that is fitted at export so that it
agrees with the error on photos held out of the training. Where no photo is wider than the camera's
view, the ring of these is the field's rendering, so the field's own error is left out.
"""
import math

import numpy as np

# Expected error that leaves a quarter of the confidence.
QUARTER_ERROR = 0.05
# confidence / 255 = exp(-DECAY * expected error)
DECAY = math.log(4) / QUARTER_ERROR


def expected_error(confidence: np.ndarray) -> np.ndarray:
    """
    Turn confidence, uint8 of any shape, into the expected error in shares of full brightness.

    float32; 0 counts as a quarter of a step, which is 0.25: where 0.2 or more is expected.
    """
    values = np.maximum(confidence.astype(np.float32), 0.25)
    return -np.log(values / 255) / np.float32(DECAY)


def confidence_of(error: np.ndarray) -> np.ndarray:
    """Turn an expected error in shares of full brightness into confidence, float 0 ... 255."""
    return np.rint(255 * np.exp(-DECAY * error))
