"""The page of a report as a jinja2 template: one file, no links, light and dark, phone to desk."""

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="neo_ros">
<title>{{ title }}</title>
<style>
:root { color-scheme: light dark;
  --paper: #fff; --card: #f6f7f9; --ink: #18181b; --pale: #5f6672; --rule: #dfe3e8;
  --mark: #fff4d1; }
@media (prefers-color-scheme: dark) { :root {
  --paper: #131519; --card: #1c1f25; --ink: #eceef1; --pale: #9da5b1; --rule: #31363f;
  --mark: #3a3113; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", sans-serif; }
main { max-width: 1160px; margin: 0 auto; padding: 1.5rem 1rem 3rem; }
h1 { font-size: 1.7rem; line-height: 1.25; margin: .3rem 0 1rem; letter-spacing: -.01em; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .6rem; padding-top: .9rem;
  border-top: 1px solid var(--rule); }
h3 { font-size: 1rem; margin: 1.5rem 0 .4rem; }
p { max-width: 44rem; margin: .5rem 0; white-space: pre-line; }
.note { color: var(--pale); font-size: .875rem; }
h3 .note { font-weight: 400; margin-left: .6rem; }
.scroll { overflow-x: auto; border: 1px solid var(--rule); border-radius: 8px; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: .5rem .8rem; text-align: right; white-space: nowrap; vertical-align: top;
  border-top: 1px solid var(--rule); }
thead th { border-top: 0; background: var(--card); color: var(--pale); font-size: .8125rem;
  font-weight: 600; }
th:first-child, td:first-child { text-align: left; }
tbody td:first-child { font-weight: 600; }
td small { display: block; color: var(--pale); font-size: .8125rem; }
tr.strong td { background: var(--mark); }
.strip { display: grid; gap: .6rem; grid-template-columns: repeat(2, 1fr); }
@media (min-width: 760px) { .strip { grid-template-columns: repeat(4, 1fr); } }
figure { margin: 0; min-width: 0; }
figure img { display: block; width: 100%; height: auto; border-radius: 4px;
  background: var(--card); }
.picture { max-width: 800px; }
figcaption { color: var(--pale); font-size: .8125rem; margin-top: .25rem; }
.plot { display: block; width: 100%; max-width: 800px; background: var(--card);
  border-radius: 8px; padding: .8rem; }
footer { margin-top: 3rem; color: var(--pale); font-size: .8125rem; }
</style>
</head>
<body>
<main>
<h1>{{ title }}</h1>
{% for kind, section in sections %}
{% if kind == 'Text' %}
{% if section.title %}<h2>{{ section.title }}</h2>{% endif %}
<p>{{ section.text }}</p>
{% elif kind == 'Table' %}
{% if section.title %}<h2>{{ section.title }}</h2>{% endif %}
<div class="scroll"><table>
<thead><tr>{% for name in section.columns %}<th>{{ name }}</th>{% endfor %}</tr></thead>
<tbody>
{% for row in section.rows %}
<tr{% if loop.index0 == section.strong_row %} class="strong"{% endif %}>
{%- for cell in row %}{% set lines = cell.split('\\n') %}<td>{{ lines[0] }}
{%- for line in lines[1:] %}<small>{{ line }}</small>{% endfor %}</td>{% endfor %}</tr>
{% endfor %}
</tbody>
</table></div>
{% if section.note %}<p class="note">{{ section.note }}</p>{% endif %}
{% elif kind == 'Plot' %}
<h2>{{ section.title }}</h2>
<img class="plot" src="{{ section|plot_uri }}" alt="{{ section.title }}">
{% if section.note %}<p class="note">{{ section.note }}</p>{% endif %}
{% elif kind == 'Picture' %}
<h2>{{ section.title }}</h2>
<figure class="picture"><img src="{{ section.image|picture_uri }}"
 width="{{ section.image.shape[1] }}" height="{{ section.image.shape[0] }}"
 alt="{{ section.title }}">
{% if section.note %}<figcaption>{{ section.note }}</figcaption>{% endif %}</figure>
{% elif kind == 'Strip' %}
<h3>{{ section.title }}{% if section.note %}<span class="note">{{ section.note }}</span>
{%- endif %}</h3>
<div class="strip">
{% for label, image in section.images %}
<figure><img src="{{ image|picture_uri }}"
 width="{{ image.shape[1] }}" height="{{ image.shape[0] }}"
 alt="{{ section.title }}: {{ label }}"><figcaption>{{ label }}</figcaption></figure>
{% endfor %}
</div>
{% endif %}
{% endfor %}
<footer>Made by neo_ros.</footer>
</main>
</body>
</html>
"""
