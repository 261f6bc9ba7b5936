import base64
from html.parser import HTMLParser
import re
from xml.etree import ElementTree

import cv2
from neo_ros.errors import NeoError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.reports.plot import plot_svg
from neo_ros.reports.report import Plot, Series, Strip, Table, Text, write_report
from neo_ros.reports.strips import error_map, frame_strip, outlined, write_strip_png
import numpy as np
import pytest

EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(32, 32, 1.5), 64, 64)


def noise(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3)).astype(np.uint8)


def smooth(height, width):
    return cv2.resize(noise(4, 4), (width, height))


class Tags(HTMLParser):
    """Collect start tags with their attributes, and check that they nest."""

    void = {'meta', 'img'}

    def __init__(self):
        super().__init__()
        self.tags, self.open = [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.void:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def parse(path):
    parser = Tags()
    parser.feed(path.read_text())
    assert parser.open == []
    return parser.tags


def decoded(uri):
    content = base64.b64decode(uri.split(',', 1)[1])
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image[..., ::-1]


def test_a_page_is_self_contained_and_holds_every_section(tmp_path):
    small, large = noise(48, 64), smooth(300, 400)
    write_report(tmp_path / 'deep/report.html', 'Title <1> & more', [
        Text('First line.\nSecond <b>line</b>.', 'Introduction'),
        Table(['Method', 'dB'], [['neo', '20.10\n19.5 to 20.7'], ['edges', '16.25']], 'Scores',
              'A note.', strong_row=0),
        Plot('Cost', 'ms', 'dB', [Series('neo', [3.0], [20.0]), Series('edges', [0.1], [16])],
             'points'),
        Strip('Best', [('camera', small), ('truth', large)], '20 dB'),
    ])
    page = (tmp_path / 'deep/report.html').read_text()
    tags = parse(tmp_path / 'deep/report.html')
    assert not re.search(r'https?:|//[a-z]', re.sub('base64,[^"]+', '', page))
    assert not {tag for tag, _ in tags} & {'script', 'link', 'iframe', 'b'}
    assert '<h1>Title &lt;1&gt; &amp; more</h1>' in page
    assert 'Second &lt;b&gt;line&lt;/b&gt;.' in page
    assert '<td>20.10<small>19.5 to 20.7</small></td>' in page
    assert page.count('class="strong"') == 1
    images = [attrs for tag, attrs in tags if tag == 'img']
    assert [(attrs.get('width'), attrs.get('height')) for attrs in images] == [
        (None, None), ('64', '48'), ('400', '300')]
    assert images[0]['alt'] == 'Cost'
    kind, plot = images[0]['src'].split(',')
    assert kind == 'data:image/svg+xml;base64' and b'</svg>' in base64.b64decode(plot)
    np.testing.assert_array_equal(decoded(images[1]['src']), small)
    assert images[2]['src'].startswith('data:image/jpeg')
    assert np.abs(decoded(images[2]['src']).astype(int) - large).mean() < 2
    assert 'prefers-color-scheme: dark' in page and 'name="viewport"' in page


def test_a_page_is_the_same_twice(tmp_path):
    for name in ('a', 'b'):
        write_report(tmp_path / name, 'Same', [
            Strip('x', [('y', noise(8, 8))]), Plot('p', 'x', 'y', [Series('s', [1, 2], [3, 4])])])
    assert (tmp_path / 'a').read_bytes() == (tmp_path / 'b').read_bytes()


def test_unwritable_pages_are_named(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(NeoError, match='report.html: cannot write'):
        write_report(tmp_path / 'file/report.html', 'x', [])


def drawn_paths(svg, series):
    """Return the paths and the markers' centres (N, 2) of a series in an SVG file."""
    spaces = {'svg': 'http://www.w3.org/2000/svg', 'link': 'http://www.w3.org/1999/xlink'}
    group = ElementTree.fromstring(svg).find(f'.//svg:g[@id="series_{series}"]', spaces)
    assert group is not None
    lines = [re.findall(r'[ML] (\S+) (\S+)', path.get('d', ''))
             for path in group.findall('svg:path', spaces)]
    marks = [(use.get('x'), use.get('y')) for use in group.iterfind('.//svg:use', spaces)]
    return [np.array(line, float) for line in lines], np.array(marks, float)


def test_lines_run_through_the_finite_points():
    [line], marks = drawn_paths(plot_svg(Plot('Walk', 'frame', 'dB', [
        Series('neo', [0, 1, 2, 3], [10.0, float('nan'), 20.0, float('inf')])])), 0)
    np.testing.assert_array_equal(line, marks)
    assert len(line) == 2
    assert line[0, 0] < line[1, 0] and line[0, 1] > line[1, 1]  # SVG counts y downwards


def test_points_are_marked_and_points_of_long_lines_are_not():
    cloud = plot_svg(Plot('Cost', 'ms', 'dB', [Series('a', [1, 2, 4], [3, 2, 1])], 'points'))
    lines = plot_svg(Plot('Walk', 'frame', 'dB', [
        Series('one', [1], [3]), Series('none', [], []), Series('all', range(99), range(99))]))
    for svg, series, line, marks in (
            (cloud, 0, 0, 3), (lines, 0, 1, 1), (lines, 1, 0, 0), (lines, 2, 99, 0)):
        paths, marked = drawn_paths(svg, series)
        assert (sum(map(len, paths)), len(marked)) == (line, marks)


def test_names_are_plain_text():
    plot = Plot('<t>', 'cost, $', '<b>', [Series('a_1 $x$', [0], [0]), Series('&', [1], [1])])
    texts = [''.join(node.itertext()).strip() for node in ElementTree.fromstring(
        plot_svg(plot)).iterfind('.//{http://www.w3.org/2000/svg}text')]
    assert {'cost, $', '<b>', 'a_1 $x$', '&'} <= set(texts)


def test_the_outline_covers_no_observed_pixel():
    wide_image = noise(64, 64)
    drawn = outlined(wide_image, EXPANSION)
    np.testing.assert_array_equal(EXPANSION.crop(drawn), EXPANSION.crop(wide_image))
    changed = (drawn != wide_image).any(axis=2)
    np.testing.assert_array_equal(changed & ~EXPANSION.seam_mask(1), False)
    assert changed[EXPANSION.seam_mask(1)].mean() > 0.99


def test_the_error_map_is_black_where_nothing_differs_and_grows_brighter():
    truth = np.full((10, 30, 3), 50, np.uint8)
    prediction = truth.copy()
    prediction[:, 10:20] += 30
    prediction[:, 20:] += 96
    brightness = error_map(truth, prediction).mean(axis=(0, 2))
    assert brightness[:10].max() < 3
    assert brightness[5] < brightness[15] < brightness[25]


@pytest.mark.parametrize('truth, labels', [
    (noise(64, 64, 1), ['camera view', 'widened view', 'truth', 'error: black 0, yellow 96/255']),
    (None, ['camera view', 'widened view'])], ids=['with_truth', 'without'])
def test_a_frame_strip_shows_the_camera_in_place(truth, labels):
    narrow_image, wide_image = noise(32, 32), noise(64, 64)
    strip = frame_strip('One', EXPANSION, narrow_image, wide_image, truth)
    assert [label for label, _ in strip.images] == labels
    np.testing.assert_array_equal(EXPANSION.crop(strip.images[0][1]), narrow_image)


def test_a_strip_png_has_a_row_per_strip(tmp_path):
    strips = [Strip('Four', [(name, noise(48, 64, i)) for i, name in enumerate('abcd')]),
              Strip('Two', [('a', smooth(512, 512)), ('b', smooth(512, 512))], 'a note')]
    write_strip_png(tmp_path / 'new/strip.png', strips)
    sheet = cv2.imread(str(tmp_path / 'new/strip.png'))
    assert sheet is not None
    height, width = sheet.shape[:2]
    assert width >= 4 * 320 and height >= 240 + 320
    # The short second row ends in white paper; its first picture is there, brought to size.
    assert (sheet[-320:, -320:] == 255).all()
    row = sheet[30 + 240 + 24 + 30:, 8:8 + 320][:320, :, ::-1]
    expected = cv2.resize(strips[1].images[0][1], (320, 320), interpolation=cv2.INTER_AREA)
    np.testing.assert_array_equal(row, expected)
    titles = [sheet[:30], sheet[294:324]]
    assert all((title < 128).any() for title in titles)
