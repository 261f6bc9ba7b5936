"""What a network runs on: a chain of ONNX Runtime's execution providers with a fall-back."""
from collections.abc import Sequence

import onnxruntime

PROVIDERS = {'tensorrt': 'TensorrtExecutionProvider', 'cuda': 'CUDAExecutionProvider',
             'cpu': 'CPUExecutionProvider'}


def choose_providers(wanted: Sequence[str]) -> list[str]:
    """
    Return ONNX Runtime's names of those of the wanted providers that it has here.

    `wanted`: keys of PROVIDERS, best first. The CPU ends every chain.
    """
    present = set(onnxruntime.get_available_providers())
    names = dict.fromkeys([*wanted, 'cpu'])
    return [PROVIDERS[name] for name in names if PROVIDERS[name] in present]
