"""The extrapolator gives the camera's pixels back, is deterministic and refuses the rest."""
from pathlib import Path

from hypothesis import given, settings, strategies as st
from neo_ros.errors import ImageRejected, ModelError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.runtime import FovExtrapolator, write_model_card
import numpy as np
import onnx
from onnx import helper, TensorProto
import pytest
from tiny_graph import tiny_graph
from tiny_model import tiny_card, TINY_EXPANSION, write_tiny_model

SIDED = ViewExpansion(Intrinsics(20, 16, 14.0, 14.0, 10.0, 8.0), 3, 8, 0, 5)


@pytest.fixture(scope='module', params=[TINY_EXPANSION, SIDED], ids=['even', 'one-sided'])
def extrapolator(request, tmp_path_factory) -> FovExtrapolator:
    path = tmp_path_factory.mktemp('model') / 'tiny.onnx'
    return FovExtrapolator.load(write_tiny_model(path, request.param), threads=1)


def _noise(expansion: ViewExpansion, seed: int) -> np.ndarray:
    size = (expansion.source.height, expansion.source.width, 3)
    return np.random.default_rng(seed).integers(0, 256, size, np.uint8)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_observed_pixels_and_repeated_runs_are_bit_identical(extrapolator, seed) -> None:
    image = _noise(extrapolator.expansion, seed)
    first, second = extrapolator.expand(image), extrapolator.expand(image.copy())
    np.testing.assert_array_equal(extrapolator.expansion.crop(first.wide_image), image)
    np.testing.assert_array_equal(first.wide_image, second.wide_image)
    np.testing.assert_array_equal(first.confidence, second.confidence)


def test_two_sessions_agree_whatever_the_threads(tmp_path: Path) -> None:
    path = write_tiny_model(tmp_path / 'm.onnx')
    image = _noise(TINY_EXPANSION, 3)
    first, second = (FovExtrapolator.load(path, threads).expand(image) for threads in (1, 2))
    np.testing.assert_array_equal(first.wide_image, second.wide_image)


def test_results_have_the_right_form_and_belong_to_the_caller(extrapolator) -> None:
    expansion = extrapolator.expansion
    image = _noise(expansion, 0)
    view = extrapolator.expand(image)
    size = (expansion.target.height, expansion.target.width)
    assert view.wide_image.shape == (*size, 3) and view.wide_image.dtype == np.uint8
    assert view.confidence.shape == size and view.confidence.dtype == np.uint8
    assert view.wide_image.flags.c_contiguous and view.confidence.flags.c_contiguous
    kept = view.wide_image.copy()
    view.confidence[:] = 0
    image[:] = 0
    assert extrapolator.expand(_noise(expansion, 1)).confidence.any()
    np.testing.assert_array_equal(view.wide_image, kept)


def test_mask_is_the_geometry_of_the_card(extrapolator) -> None:
    np.testing.assert_array_equal(
        extrapolator.extrapolated_mask, extrapolator.expansion.extrapolated_mask)
    confidence = extrapolator.expand(_noise(extrapolator.expansion, 0)).confidence
    np.testing.assert_array_equal(confidence < 255, extrapolator.extrapolated_mask)


def test_a_view_that_is_not_contiguous_gives_the_same(extrapolator) -> None:
    image = _noise(extrapolator.expansion, 5)
    flipped = np.ascontiguousarray(image[:, ::-1])[:, ::-1]
    np.testing.assert_array_equal(
        extrapolator.expand(flipped).wide_image, extrapolator.expand(image).wide_image)


@pytest.mark.parametrize('image', [
    np.zeros((24, 33, 3), np.uint8), np.zeros((32, 24, 3), np.uint8),
    np.zeros((24, 32), np.uint8), np.zeros((24, 32, 4), np.uint8),
    np.zeros((1, 24, 32, 3), np.uint8), np.zeros((24, 32, 3), np.float32),
    np.zeros((0, 0, 3), np.uint8),
], ids=['wider', 'turned', 'mono', 'rgba', 'batch', 'float', 'empty'])
def test_images_of_another_size_are_rejected(tmp_path: Path, image: np.ndarray) -> None:
    extrapolator = FovExtrapolator.load(write_tiny_model(tmp_path / 'm.onnx'))
    with pytest.raises(ImageRejected, match='24, 32, 3') as caught:
        extrapolator.expand(image)
    assert caught.value.reason == 'size'


def _rename_input(model: onnx.ModelProto) -> None:
    model.graph.input[0].name = 'picture'
    model.graph.node[0].input[0] = 'picture'


def _drop_confidence(model: onnx.ModelProto) -> None:
    del model.graph.output[1]


def _any_batch(model: onnx.ModelProto) -> None:
    model.graph.input[0].type.tensor_type.shape.dim[0].dim_param = 'batch'


def _float_output(model: onnx.ModelProto) -> None:
    model.graph.node.append(
        helper.make_node('Cast', ['confidence'], ['sure'], to=TensorProto.FLOAT))
    model.graph.output[1].CopyFrom(
        helper.make_tensor_value_info('sure', TensorProto.FLOAT, [1, 48, 64]))


def _second_input(model: onnx.ModelProto) -> None:
    model.graph.input.append(helper.make_tensor_value_info('depth', TensorProto.FLOAT, [1]))


def _unknown_operator(model: onnx.ModelProto) -> None:
    model.graph.node[0].op_type = 'Teleport'


def _changes_pixels(model: onnx.ModelProto) -> None:
    model.graph.node[4].input[2] = 'blurred'


@pytest.mark.parametrize(('break_it', 'message'), [
    (_rename_input, 'does not agree with the graph.*picture'),
    (_drop_confidence, 'does not agree with the graph.*output'),
    (_any_batch, 'does not agree with the graph.*batch'),
    (_float_output, 'does not agree with the graph.*float'),
    (_second_input, 'does not agree with the graph.*depth'),
    (_unknown_operator, 'operators that .* got Teleport'),
    (_changes_pixels, 'changes pixels that the camera saw'),
], ids=lambda value: getattr(value, '__name__', ''))
def test_graphs_that_break_their_card_are_refused(tmp_path: Path, break_it, message) -> None:
    path = tmp_path / 'm.onnx'
    model = tiny_graph()
    break_it(model)
    path.write_bytes(model.SerializeToString())
    write_model_card(path, tiny_card())
    with pytest.raises(ModelError, match=message):
        FovExtrapolator.load(path)


@pytest.mark.parametrize('expansion', [
    ViewExpansion.to_size(Intrinsics(32, 24, 16.0, 16.0, 16.0, 12.0), 64, 50),
    ViewExpansion.to_size(Intrinsics(24, 32, 16.0, 16.0, 12.0, 16.0), 48, 64),
    ViewExpansion(Intrinsics(32, 24, 16.0, 16.0, 16.0, 12.0), 14, 18, 12, 12),
], ids=['target', 'source', 'placement'])
def test_a_card_of_another_expansion_is_refused(tmp_path: Path, expansion) -> None:
    path = write_tiny_model(tmp_path / 'm.onnx')
    write_model_card(path, tiny_card(expansion))
    with pytest.raises(ModelError, match='does not agree|changes pixels'):
        FovExtrapolator.load(path)


def test_bad_files_are_refused_before_a_session_exists(tmp_path: Path, monkeypatch) -> None:
    import onnxruntime

    def no_session(*args: object, **kwargs: object) -> None:
        raise AssertionError('a session was created')

    monkeypatch.setattr(onnxruntime, 'InferenceSession', no_session)
    path = write_tiny_model(tmp_path / 'm.onnx')
    onnx.save_model(onnx.load(str(path)), str(path), save_as_external_data=True,
                    location='weights.bin', size_threshold=0)
    with pytest.raises(ModelError, match='external data'):
        FovExtrapolator.load(path)
    path.write_bytes(b'')
    with pytest.raises(ModelError, match='empty'):
        FovExtrapolator.load(path)
