"""Hostile model files are refused before ONNX Runtime sees them."""
import os
from pathlib import Path

from neo_ros.errors import ModelError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.machine.regular_file import MAX_BYTES
from neo_ros.runtime import fov_extrapolator, FovExtrapolator, onnx_file, write_model_card
from neo_ros.runtime.model_file import open_model
from neo_ros.runtime.onnx_file import scan_onnx_file
import numpy as np
import onnx
from onnx import helper, numpy_helper, TensorProto
import pytest
from tiny_graph import KEPT, tiny_graph
from tiny_model import graph_file, tiny_card, TINY_EXPANSION, write_tiny_model


@pytest.fixture
def no_session(monkeypatch):
    """Fail where a session is built."""
    def refuse(*arguments, **options):
        raise AssertionError('a session was built')
    monkeypatch.setattr(fov_extrapolator.onnxruntime, 'InferenceSession', refuse)


def write(path: Path, model: onnx.ModelProto) -> Path:
    path.write_bytes(model.SerializeToString())
    write_model_card(path, tiny_card())
    return path


def external(location: str):
    """Return a change that keeps a tensor in another file."""
    def change(model: onnx.ModelProto) -> None:
        tensor = TensorProto(name='hidden', data_type=TensorProto.FLOAT, dims=[1],
                             data_location=TensorProto.EXTERNAL)
        tensor.external_data.add(key='location', value=location)
        model.graph.initializer.append(tensor)
    return change


def test_a_field_that_onnx_runtime_sees_is_seen(tmp_path: Path, no_session: None) -> None:
    # A tag of five bytes, cut to 32 bits by protobuf: field 7, a graph that is merged in.
    hidden = helper.make_graph([helper.make_node('Loop', ['n', 'go'], ['x'])], 'hidden', [], [])
    part = hidden.SerializeToString()
    path = write_tiny_model(tmp_path / 'model.onnx')
    for tag, what in ((b'\xba\x80\x80\x80\x10', 'more than 32 bits'),
                      (b'\xba' + b'\x80' * 8 + b'\x02', 'does not end')):
        bad = tmp_path / 'bad.onnx'
        bad.write_bytes(path.read_bytes() + tag + bytes([len(part)]) + part)
        with pytest.raises(ModelError, match=what):
            open_model(bad)
    assert len(part) < 128


def _custom_operator(model: onnx.ModelProto) -> None:
    model.graph.node.append(helper.make_node('Add', ['image'], ['x'], domain='evil.ops'))


def _contrib_operator(model: onnx.ModelProto) -> None:
    model.graph.node.append(helper.make_node('Gelu', ['image'], ['x'], domain='com.microsoft'))


def _control_flow(model: onnx.ModelProto) -> None:
    body = helper.make_graph([helper.make_node('Add', ['a', 'b'], ['c'])], 'body', [], [])
    model.graph.node.append(helper.make_node('Loop', ['n', 'go'], ['x'], body=body))


def _hidden_graph(model: onnx.ModelProto) -> None:
    body = helper.make_graph([helper.make_node('Add', ['a', 'b'], ['c'])], 'body', [], [])
    model.graph.node.append(helper.make_node('Add', ['image'], ['x'], body=body))


def _function(model: onnx.ModelProto) -> None:
    node = helper.make_node('Add', ['a', 'a'], ['b'])
    model.functions.append(helper.make_function(
        'evil', 'Add', ['a'], ['b'], [node], [helper.make_opsetid('', 18)]))


def _huge_constant(model: onnx.ModelProto) -> None:
    shape = numpy_helper.from_array(np.array([1 << 20, 1 << 20], np.int64), 'shape')
    model.graph.initializer.append(shape)
    model.graph.node.append(helper.make_node('ConstantOfShape', ['shape'], ['x']))


def _random(model: onnx.ModelProto) -> None:
    model.graph.node.append(helper.make_node('RandomNormal', [], ['x'], shape=[1 << 30]))


def _more_inputs(model: onnx.ModelProto) -> None:
    model.graph.input.append(helper.make_tensor_value_info('more', TensorProto.FLOAT, [1]))


def _more_outputs(model: onnx.ModelProto) -> None:
    model.graph.output.append(helper.make_tensor_value_info('more', TensorProto.FLOAT, [1]))


def _no_shape(model: onnx.ModelProto) -> None:
    model.graph.input[0].type.tensor_type.ClearField('shape')


def _sequence_input(model: onnx.ModelProto) -> None:
    value = helper.make_tensor_sequence_value_info('image', TensorProto.UINT8, None)
    model.graph.input[0].CopyFrom(value)


@pytest.mark.parametrize('change, words', [
    (external('weights.bin'), 'external data'),
    (external('../../../../etc/passwd'), 'external data'),
    (external('/etc/passwd'), 'external data'),
    (_custom_operator, 'evil.ops.Add'),
    (_contrib_operator, 'com.microsoft.Gelu'),
    (_control_flow, 'Loop'),
    (_hidden_graph, '2 graphs'),
    (_function, '1 functions'),
    (_huge_constant, 'ConstantOfShape'),
    (_random, 'RandomNormal'),
    (_more_inputs, 'expected input.*more'),
    (_more_outputs, 'expected output.*more'),
    (_no_shape, 'expected input'),
    (_sequence_input, 'expected input'),
], ids=['external', 'traversal', 'absolute path', 'custom operator', 'contrib operator',
        'control flow', 'hidden graph', 'function', 'huge constant', 'random', 'more inputs',
        'more outputs', 'no shape', 'sequence'])
def test_hostile_graphs_are_refused_before_a_session(
        tmp_path, no_session, change, words) -> None:
    model = tiny_graph()
    change(model)
    path = write(tmp_path / 'm.onnx', model)
    with pytest.raises(ModelError, match=words):
        FovExtrapolator.load(path)


def test_external_data_behind_a_symbolic_link_is_refused(tmp_path, no_session) -> None:
    secret = tmp_path / 'secret.bin'
    secret.write_bytes(bytes(4))
    (tmp_path / 'weights.bin').symlink_to(secret)
    model = tiny_graph()
    external('weights.bin')(model)
    with pytest.raises(ModelError, match='external data'):
        FovExtrapolator.load(write(tmp_path / 'm.onnx', model))


def test_what_is_no_regular_file_is_refused_at_once(tmp_path, no_session) -> None:
    pipe, link = tmp_path / 'pipe.onnx', tmp_path / 'link.onnx'
    os.mkfifo(pipe)
    link.symlink_to('/dev/zero')
    for path in (pipe, link, tmp_path):
        with pytest.raises(ModelError, match='cannot read the model'):
            FovExtrapolator.load(path)
    (tmp_path / 'loop.onnx').symlink_to(tmp_path / 'loop.onnx')
    with pytest.raises(ModelError, match='cannot read the model'):
        FovExtrapolator.load(tmp_path / 'loop.onnx')
    with pytest.raises(ModelError, match='cannot read the model'):
        FovExtrapolator.load(tmp_path / 'a\0b.onnx')


def test_a_link_to_a_model_is_followed(tmp_path) -> None:
    # colcon --symlink-install makes links of the shipped models.
    path = write_tiny_model(tmp_path / 'm.onnx')
    (tmp_path / 'link.onnx').symlink_to(path)
    assert open_model(tmp_path / 'link.onnx')[0] == path.read_bytes()


def test_an_oversized_file_is_refused_unread(tmp_path, no_session) -> None:
    path = tmp_path / 'huge.onnx'
    with path.open('wb') as file:
        file.truncate(MAX_BYTES + 1)  # Sparse: takes no space.
    with pytest.raises(ModelError, match='at most 1024 MB'):
        FovExtrapolator.load(path)


def test_a_file_of_countless_small_parts_is_refused(tmp_path, monkeypatch, no_session) -> None:
    monkeypatch.setattr(onnx_file, 'MAX_PARTS', 2000)
    model = tiny_graph()
    model.graph.node.extend([onnx.NodeProto()] * 2001)
    with pytest.raises(ModelError, match='more than 2000 parts'):
        FovExtrapolator.load(write(tmp_path / 'm.onnx', model))


def test_countless_fields_that_onnx_does_not_know_are_refused(
        tmp_path, monkeypatch, no_session) -> None:
    monkeypatch.setattr(onnx_file, 'MAX_PARTS', 2000)
    path = write_tiny_model(tmp_path / 'm.onnx')
    scan_onnx_file(path)
    with path.open('ab') as file:
        file.write(b'\x98\x06\x00' * 2000)  # Field 99, a number: 0.
    with pytest.raises(ModelError, match='more than 2000 parts'):
        FovExtrapolator.load(path)


def test_a_card_of_a_gigantic_view_is_refused(tmp_path, no_session) -> None:
    expansion = ViewExpansion.to_size(Intrinsics(32, 24, 16, 16, 16, 12), 200_000, 200_000)
    path = tmp_path / 'm.onnx'
    path.write_bytes(tiny_graph().SerializeToString())
    write_model_card(path, tiny_card(expansion))
    with pytest.raises(ModelError, match='at most 67108864 pixels'):
        FovExtrapolator.load(path)


def test_what_was_checked_is_what_runs(tmp_path, monkeypatch) -> None:
    path = write_tiny_model(tmp_path / 'm.onnx')
    honest = path.read_bytes()

    def swap(path_: Path):
        found = scan_onnx_file(path_)
        path.write_bytes(b'replaced after the check')
        return found
    monkeypatch.setattr('neo_ros.runtime.model_file.scan_onnx_file', swap)
    extrapolator = FovExtrapolator.load(path)
    assert path.read_bytes() != honest
    assert extrapolator.expand(np.zeros((24, 32, 3), np.uint8)).wide_image.shape == (48, 64, 3)


def test_inputs_and_outputs_are_read_from_the_graph(tmp_path) -> None:
    found = scan_onnx_file(write_tiny_model(tmp_path / 'm.onnx'))
    assert found.inputs == {'image': 'tensor(uint8) [1, 24, 32, 3]'}
    assert found.outputs == {'wide': 'tensor(uint8) [1, 48, 64, 3]',
                             'confidence': 'tensor(uint8) [1, 48, 64]'}
    assert found.operators == {node.op_type for node in tiny_graph(TINY_EXPANSION).graph.node}
    assert (found.graphs, found.functions) == (1, 0)


def test_the_kept_files_are_what_onnx_makes_of_the_graph() -> None:
    for expansion in KEPT:
        assert onnx.load(graph_file(expansion)) == tiny_graph(expansion)
