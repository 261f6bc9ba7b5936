import base64
from html.parser import HTMLParser
import re

import cv2
from hypothesis import given, strategies as st
from neo_ros.errors import NeoError
from neo_ros.evaluation.report import Plot, Series, Strip, Table, Text, write_report
from neo_ros.evaluation.report_plot import plot_svg, ticks
from neo_ros.evaluation.strips import error_map, frame_strip, outlined, write_strip_png
from neo_ros.geometry import Intrinsics, ViewExpansion
import numpy as np
import pytest

EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(32, 32, 1.5), 64, 64)


def noise(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3)).astype(np.uint8)


def smooth(height, width):
    return cv2.resize(noise(4, 4), (width, height))


class Tags(HTMLParser):
    """Collect start tags with their attributes, and check that they nest."""

    void = {'meta', 'img', 'line', 'circle', 'polyline'}

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
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


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
    assert [(attrs['width'], attrs['height']) for attrs in images] == [
        ('64', '48'), ('400', '300')]
    np.testing.assert_array_equal(decoded(images[0]['src']), small)
    assert images[1]['src'].startswith('data:image/jpeg')
    assert np.abs(decoded(images[1]['src']).astype(int) - large).mean() < 2
    assert [attrs['class'] for tag, attrs in tags if tag == 'circle'] == ['dot c0', 'dot c1']
    assert 'prefers-color-scheme: dark' in page and 'name="viewport"' in page


def test_a_page_is_the_same_twice(tmp_path):
    for name in ('a', 'b'):
        write_report(tmp_path / name, 'Same', [Strip('x', [('y', noise(8, 8))])])
    assert (tmp_path / 'a').read_bytes() == (tmp_path / 'b').read_bytes()


def test_unwritable_pages_are_named(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(NeoError, match='report.html: cannot write'):
        write_report(tmp_path / 'file/report.html', 'x', [])


def test_lines_run_through_the_finite_points():
    svg = plot_svg(Plot('Walk', 'frame', 'dB', [
        Series('neo', [0, 1, 2, 3], [10.0, float('nan'), 20.0, float('inf')])]))
    points = re.search('polyline class="line c0" points="([^"]+)"', svg).group(1).split()
    assert len(points) == 2
    (x0, y0), (x1, y1) = (map(float, point.split(',')) for point in points)
    assert x0 < x1 and y0 > y1  # SVG counts y downwards


@given(st.lists(st.floats(-1e6, 1e6).map(lambda value: round(value, 3)), max_size=20))
def test_ticks_enclose_all_values_evenly(values):
    marks = ticks(values)
    assert 2 <= len(marks) <= 9
    steps = np.diff(marks)
    assert (steps > 0).all()
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6)
    slack = 1e-6 * steps[0]
    assert all(marks[0] - slack <= value <= marks[-1] + slack for value in values)


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
    height, width = sheet.shape[:2]
    assert width >= 4 * 320 and height >= 240 + 320
    # The short second row ends in white paper; its first picture is there, brought to size.
    assert (sheet[-320:, -320:] == 255).all()
    row = sheet[30 + 240 + 24 + 30:, 8:8 + 320][:320, :, ::-1]
    expected = cv2.resize(strips[1].images[0][1], (320, 320), interpolation=cv2.INTER_AREA)
    np.testing.assert_array_equal(row, expected)
    titles = [sheet[:30], sheet[294:324]]
    assert all((title < 128).any() for title in titles)
