"""Model cards: what is written is what is read, and everything else is refused."""
import json
from pathlib import Path

from neo_ros.errors import ModelError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.runtime import ModelCard, read_model_card, write_model_card
from neo_ros.runtime.model_card import MemoryFile
from neo_ros.runtime.onnx_file import scan_onnx_file
import onnx
from onnx import helper, TensorProto
import pytest
from tiny_graph import tiny_graph
from tiny_model import tiny_card, write_tiny_model


def test_card_survives_the_file(tmp_path: Path) -> None:
    expansion = ViewExpansion(Intrinsics(30, 20, 21.5, 22.5, 14.25, 9.75), 4, 0, 3, 9)
    card = tiny_card(expansion, scores={'psnr': 24.5}, trained_seconds=12.5)
    path = write_tiny_model(tmp_path / 'm.onnx', expansion, scores={'psnr': 24.5},
                            trained_seconds=12.5)
    assert read_model_card(path) == card
    assert read_model_card(path).expansion == expansion


def test_writing_a_card_replaces_the_old_one_and_keeps_other_metadata(tmp_path: Path) -> None:
    path = write_tiny_model(tmp_path / 'm.onnx')
    model = onnx.load(str(path))
    model.metadata_props.add(key='author', value='somebody')
    onnx.save_model(model, str(path))
    write_model_card(path, tiny_card(scene_id='kitchen'))
    assert read_model_card(path).scene_id == 'kitchen'
    assert scan_onnx_file(path).metadata['author'] == 'somebody'
    assert len(onnx.load(str(path)).metadata_props) == 2


def _card_with(**changes: object) -> str:
    fields = json.loads(tiny_card().to_json())
    for name, value in changes.items():
        if value is None:
            del fields[name]
        else:
            fields[name] = value
    return json.dumps(fields)


@pytest.mark.parametrize(('text', 'message'), [
    ('', 'expected a JSON object'),
    ('{"schema_version": 1', 'expected a JSON object'),
    ('[1]', 'expected a JSON object'),
    (_card_with(schema_version=None), 'expected a JSON object'),
    (_card_with(schema_version=2, news='x'), 'schema_version 2 is newer than 1'),
    (_card_with(schema_version='1'), 'schema_version'),
    (_card_with(scene_id=None), 'scene_id'),
    (_card_with(scene_id=7), 'scene_id'),
    (_card_with(expansion={'left': 1}), 'expansion'),
    (_card_with(mask_polarity='0 = extrapolated'), 'mask_polarity'),
    (_card_with(input={'layout': 'NCHW'}), 'input.layout'),
    (_card_with(input={'colour_order': 'BGR'}), 'input.colour_order'),
    (_card_with(parity={'max_abs_error': 1, 'share_within_1': 1.5}), 'parity.share_within_1'),
    (_card_with(scores={'psnr': float('nan')}), 'scores.psnr'),
    (_card_with(nickname='x'), 'nickname'),
    (_card_with(scores={'psnr': 10 ** 400}), 'scores.psnr'),
    (_card_with(trained_seconds=True), 'trained_seconds'),
    (_card_with(scene_id='\ud800'), 'scene_id'),
    (_card_with(parity=7), 'parity: expected an object'),
    (_card_with(parity={'max_abs_error': '1', 'share_within_1': 1}), 'parity.max_abs_error'),
    ('[' * 100_000, 'expected a JSON object'),
], ids=['empty', 'cut', 'list', 'no version', 'newer', 'version as text', 'no scene',
        'wrong type', 'no source', 'polarity', 'layout', 'colour order', 'parity range', 'nan',
        'unknown key', 'huge', 'bool', 'surrogate', 'no object', 'number as text', 'deep'])
def test_wrong_card_is_refused_by_name(text: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        ModelCard.from_json(text)


@pytest.mark.parametrize('name', ['room.memory', 'my room.memory', 'Küche (2).v1.memory', '...a'])
def test_a_memory_may_have_any_name_of_a_file_as_scene_folders_have(name: str) -> None:
    card = tiny_card(memory=MemoryFile(file=name, sha256='0' * 64))
    assert ModelCard.from_json(card.to_json()).memory == card.memory
    assert Path('models', 'room.onnx').with_name(name).parent == Path('models')


@pytest.mark.parametrize('name', [
    '', '.', '..', '...', '/etc/passwd', '../room.memory', 'a/b', 'a/', 'a\\b', '..\\b', 'a\nb',
    'a\n', 'a\0b', 'a\x7f'])
def test_a_memory_never_leads_out_of_the_folder_of_its_model(name: str) -> None:
    with pytest.raises(ModelError, match='memory.file'):
        ModelCard.from_json(_card_with(memory={'file': name, 'sha256': '0' * 64}))


def test_expansion_of_a_card_is_checked_as_geometry() -> None:
    fields = json.loads(tiny_card().to_json())
    fields['expansion']['source']['fx'] = -1.0
    with pytest.raises(ModelError, match='fx: expected a focal length'):
        ModelCard.from_json(json.dumps(fields))


@pytest.mark.parametrize('content', [
    b'', b'\x00', b'hello, I am no model\n' * 40, b'\x89PNG\r\n\x1a\n' + bytes(300),
    b'PK\x03\x04' + bytes(300), b'\xff' * 300, b'\x08\x0a',
], ids=['empty', 'one byte', 'text', 'png', 'zip', 'ones', 'header only'])
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / 'm.onnx'
    path.write_bytes(content)
    with pytest.raises(ModelError, match='m.onnx'):
        read_model_card(path)


def test_missing_file_folder_and_cardless_model_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match='no such model file'):
        read_model_card(tmp_path / 'nowhere.onnx')
    with pytest.raises(ModelError, match='cannot read the model'):
        read_model_card(tmp_path)
    onnx.save_model(tiny_graph(), str(tmp_path / 'bare.onnx'))
    with pytest.raises(ModelError, match='no model card'):
        read_model_card(tmp_path / 'bare.onnx')


def test_every_truncation_is_refused(tmp_path: Path) -> None:
    content = write_tiny_model(tmp_path / 'm.onnx').read_bytes()
    path = tmp_path / 'cut.onnx'
    for size in {*range(0, len(content), 61), *range(len(content) - 40, len(content))}:
        path.write_bytes(content[:size])
        with pytest.raises(ModelError):
            read_model_card(path)


def _external(name: str = 'hidden') -> onnx.TensorProto:
    tensor = TensorProto(name=name, data_type=TensorProto.FLOAT, dims=[1],
                         data_location=TensorProto.EXTERNAL)
    tensor.external_data.add(key='location', value='weights.bin')
    return tensor


def _in_initializer(model: onnx.ModelProto) -> None:
    model.graph.initializer.append(_external())


def _in_constant(model: onnx.ModelProto) -> None:
    model.graph.node.append(helper.make_node('Constant', [], ['c'], value=_external()))


def _in_subgraph(model: onnx.ModelProto) -> None:
    inner = helper.make_graph([], 'inner', [], [], [_external()])
    model.graph.node.append(
        helper.make_node('If', ['b'], ['c'], then_branch=inner, else_branch=inner))


def _in_function(model: onnx.ModelProto) -> None:
    node = helper.make_node('Constant', [], ['c'], value=_external())
    model.functions.append(helper.make_function(
        'local', 'f', [], ['c'], [node], [helper.make_opsetid('', 18)]))


def _in_sparse(model: onnx.ModelProto) -> None:
    sparse = onnx.SparseTensorProto(values=_external(), indices=TensorProto(), dims=[1])
    model.graph.sparse_initializer.append(sparse)


@pytest.mark.parametrize(
    'hide', [_in_initializer, _in_constant, _in_subgraph, _in_function, _in_sparse])
def test_external_data_is_found_wherever_it_hides(tmp_path: Path, hide) -> None:
    path = write_tiny_model(tmp_path / 'm.onnx')
    model = onnx.load(str(path))
    hide(model)
    path.write_bytes(model.SerializeToString())
    assert set(scan_onnx_file(path).external_tensors) == {'hidden'}
    with pytest.raises(ModelError, match='external data'):
        read_model_card(path)


def test_external_data_as_onnx_writes_it_is_refused(tmp_path: Path) -> None:
    path = write_tiny_model(tmp_path / 'm.onnx')
    onnx.save_model(onnx.load(str(path)), str(path), save_as_external_data=True,
                    location='weights.bin', size_threshold=0)
    assert (tmp_path / 'weights.bin').exists()
    with pytest.raises(ModelError, match='one self-contained file'):
        read_model_card(path)


def test_scan_knows_the_field_numbers_of_onnx() -> None:
    from neo_ros.runtime import onnx_file

    kinds = {'ModelProto': 'model', 'GraphProto': 'graph', 'NodeProto': 'node',
             'AttributeProto': 'attribute', 'FunctionProto': 'function',
             'SparseTensorProto': 'sparse_tensor', 'TrainingInfoProto': 'training'}
    leaves = {'TensorProto': 'tensor', 'StringStringEntryProto': 'metadata',
              'ValueInfoProto': 'value'}
    for kind, name in kinds.items():
        expected = {
            field.number: {**kinds, **leaves}[field.message_type.name]
            for field in getattr(onnx, kind).DESCRIPTOR.fields
            if field.message_type and field.message_type.name in {**kinds, **leaves}
            and (kind == 'ModelProto' or field.message_type.name != 'StringStringEntryProto')
            and 'binding' not in field.name}
        assert onnx_file._CHILDREN[name] == expected, kind
