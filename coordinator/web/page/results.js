// What came out: parameters, diagnoses, artefacts and where they come from.
(function () {
  'use strict';
  var el = page.el, replace = page.replace;

  function residuals(history) {
    var rows = history.versions.filter(function (v) { return v.residual_after !== null || v.residual_before !== null; })
      .map(function (v) { return [v.version, v.residual_before, v.residual_after]; }).sort(function (a, b) { return a[0] - b[0]; });
    if (rows.length < 2) { return null; }  // the table says it
    var positive = rows.every(function (r) { return (r[1] === null || r[1] > 0) && (r[2] === null || r[2] > 0); });
    return makePlot({ title: 'Residual by iteration', labels: ['version', 'before', 'after'], rows: rows, log: positive, xlabel: 'version', ylabel: 'residual' });
  }

  // How far a parameter has gone, in standard deviations where they are known, else relative.
  function travel(p) {
    var values = p.values.filter(function (v) { return v !== null; });
    if (values.length < 2) { return -1; }
    var way = Math.max.apply(null, values) - Math.min.apply(null, values);
    var known = p.stddevs.filter(function (s) { return s; });
    return way / (known.length ? known[known.length - 1] : Math.max(Math.abs(values[0]), 1e-9));
  }

  function parameterPlot(values, p) {
    return makePlot({
      title: p.name, labels: ['version', p.name], bars: true, xlabel: 'version', ylabel: '',
      rows: values.versions.map(function (v, i) {
        var s = p.stddevs[i] || 0, x = p.values[i];
        return [v, x === null ? [null, null, null] : [x - s, x, x + s]];
      })
    });
  }

  // Of a single version: a table, those that the data tell most of first.
  function valueTable(wanted) {
    var relative = function (p) { return p.stddevs[0] ? p.stddevs[0] / Math.max(Math.abs(p.values[0]), 1e-9) : Infinity; };
    wanted.sort(function (a, b) { return relative(a) === relative(b) ? 0 : relative(a) - relative(b); });
    return page.table([{ name: 'Parameter' }, { name: 'Value', num: true }, { name: 'Standard deviation', num: true }], wanted.map(function (p) {
      return { attributes: { 'data-parameter': p.name }, cells: [p.name, page.number(p.values[0]), p.stddevs[0] ? page.number(p.stddevs[0]) : ''] };
    }));
  }

  function drawParameters(root, robots, robot) {
    var history = el('div#history'), plots = el('div.plots#parameter-plots'), residual = el('div.plots#residuals'), shown = 12, values = null;
    var search = el('input', { type: 'search', placeholder: 'parameter, e.g. damping', 'aria-label': 'parameters to plot', oninput: function () { draw(); } });
    var choose = el('select', { 'aria-label': 'robot', onchange: function () { location.hash = '#/parameters/' + encodeURIComponent(choose.value); } },
      robots.map(function (r) { return el('option', { value: r, selected: r === robot ? '' : null }, r); }));
    function draw() {
      if (!values) { return; }
      var wanted = values.parameters.filter(function (p) { return p.name.toLowerCase().indexOf(search.value.toLowerCase()) >= 0; });
      var single = values.versions.length < 2;
      heading.textContent = single ? 'Values of the only version' : 'Values by version, with a standard deviation to each side; those that moved most first';
      plots.className = single ? '' : 'plots';
      if (single) { more.hidden = true; return replace(plots, valueTable(wanted)); }
      wanted.sort(function (a, b) { return travel(b) - travel(a); });
      var cut = wanted.slice(0, shown);
      replace(plots, cut.map(function (p) { return parameterPlot(values, p); }).reduce(function (f, n) { f.append(n); return f; }, document.createDocumentFragment()));
      more.hidden = wanted.length <= shown;
      more.textContent = 'more of ' + wanted.length;
    }
    var heading = el('h2');
    var more = el('button', { hidden: '', onclick: function () { shown += 24; draw(); } }, 'more');
    replace(root, el('h1', null, 'Parameters'), el('div.tools', null, choose, search), residual,
      heading, plots, el('div.tools', null, more), el('h2', null, 'History'), history);
    page.live(function () { return '/api/history?robot=' + encodeURIComponent(robot); }, function (value, error) {
      if (error) { return replace(history, el('p.note.bad', null, error)); }
      var plot = residuals(value);
      replace(residual, plot);
      replace(history, page.table(
        [{ name: 'Version', num: true }, { name: 'From', num: true }, { name: 'Source' }, { name: 'Before', num: true }, { name: 'After', num: true }, { name: 'Rollout' }, { name: 'Recording' }, { name: 'Model' }, { name: 'Job' }, { name: 'Created' }, { name: 'Note' }],
        value.versions.map(function (v) {
          return {
            attributes: { 'data-version': v.version },
            cells: [String(v.version) + (v.version === value.current ? ' (current)' : ''), v.parent || '', v.source, page.number(v.residual_before), page.number(v.residual_after),
              v.rollout + (v.held_back ? ' (held back)' : ''), v.recording ? page.artifact(v.recording) : '', v.model ? page.artifact(v.model) : '', v.job ? el('a', { href: '#/job/' + v.job }, v.job) : '', page.moment(v.created), v.note]
          };
        })));
      page.ask('/api/values?robot=' + encodeURIComponent(robot)).then(function (v) { values = v; draw(); }).catch(function (e) { replace(plots, el('p.note.bad', null, e.message)); });
    }, 3000);
  }

  page.add({
    path: 'parameters', title: 'Parameters',
    draw: function (root, robot) {
      var known = null;
      replace(root, el('h1', null, 'Parameters'));
      page.live(function () { return '/api/robots'; }, function (value, error) {
        if (error) { return replace(root, el('p.note.bad', null, error)); }
        if (!value.robots.length) { return replace(root, el('h1', null, 'Parameters'), el('p.soft', null, 'No version yet: an iteration makes the first.')); }
        if (known === value.robots.join('\n')) { return; }
        known = value.robots.join('\n');
        drawParameters(root, value.robots, value.robots.indexOf(robot) >= 0 ? robot : value.robots[0]);
      }, 5000);
    }
  });

  function diagnosisPanel(d) {
    return el('div.panel', { 'data-diagnosis': d.sha256 },
      el('h3', null, page.artifact(d.sha256, (d.verdict || 'diagnosis').replace(/_/g, ' ')), d.job ? [' · ', el('a', { href: '#/job/' + d.job }, 'job ' + d.job)] : null,
        el('span.soft', null, ' · ' + page.moment(d.created))),
      d.findings.map(function (f) { return el('p', null, f.statement || f.effect, el('span.soft', null, ' (' + f.joints.join(', ') + '; confidence ' + page.number(f.confidence) + ')')); }),
      d.before !== null ? el('p.soft', null, 'held-out error ' + page.number(d.before) + ' before, ' + page.number(d.after) + ' after') : null,
      d.report ? el('p', null, el('a', { href: '#/report/' + d.report }, 'the whole report')) : null);
  }

  page.add({
    path: 'diagnoses', title: 'Diagnoses',
    draw: function (root) {
      var list = el('div#diagnoses'), reports = el('div#reports');
      replace(root, el('h1', null, 'Diagnoses'), list, el('h2', null, 'Reports'), reports);
      page.live(function () { return '/api/diagnoses'; }, function (value, error) {
        if (error) { return replace(list, el('p.note.bad', null, error)); }
        replace(list, value.diagnoses.length ? value.diagnoses.map(diagnosisPanel).reduce(function (f, n) { f.append(n); return f; }, document.createDocumentFragment()) :
          el('p.soft', null, 'None yet: realitygrad submit diagnose, or submit iteration --diagnose.'));
        replace(
            reports,
            value.reports.length ?
                page.table(
                    [{name: 'Report'}, {name: 'Job'}, {name: 'Created'}, {name: 'Size', num: true}],
                    value.reports.map(function(r) {
                      return {
                        cells: [
                          el('a', {href: '#/report/' + r.sha256}, r.sha256.slice(0, 12)),
                          r.job ? el('a', {href: '#/job/' + r.job}, r.job) : '', page.moment(r.created),
                          page.bytes(r.size_bytes)
                        ]
                      };
                    })) :
                el('p.soft', null, 'None yet.'));
      }, 3000);
    }
  });

  page.add({
    path: 'report', title: 'Report', under: 'diagnoses',
    draw: function (root, sha) {
      replace(root, el('div.tools', null, page.artifact(sha, 'where it comes from'), el('a', { href: '/artifact/' + sha, target: '_blank', rel: 'noopener' }, 'on a page of its own')),
        el('iframe', { src: '/artifact/' + sha, sandbox: 'allow-scripts', title: 'report' }));
    }
  });

  page.add({
    path: 'artifacts', title: 'Artefacts',
    draw: function (root) {
      var list = el('div#artifacts'), refresh;
      var kind = el('input', { type: 'search', placeholder: 'kind, e.g. model', 'aria-label': 'kind', oninput: function () { refresh(); } });
      replace(root, el('h1', null, 'Artefacts'), el('div.tools', null, kind), list);
      refresh = page.live(function () { return '/api/artifacts?kind=' + encodeURIComponent(kind.value.trim()); }, function (value, error) {
        if (error) { return replace(list, el('p.note.bad', null, error)); }
        replace(
            list,
            value.artifacts.length ?
                page.table(
                    [
                      {name: 'Artefact'}, {name: 'Kind'}, {name: 'Size', num: true}, {name: 'Job'},
                      {name: 'Created'}
                    ],
                    value.artifacts.map(function(a) {
                      return {
                        cells: [
                          page.artifact(a.sha256), a.kind, page.bytes(a.size_bytes),
                          a.job ? el('a', {href: '#/job/' + a.job}, a.job) : '', page.moment(a.created)
                        ]
                      };
                    })) :
                el('p.soft', null, 'None.'));
      }, 3000);
    }
  });

  // Columns by distance from the artefact: what it was made from to the left, what was made from it to the right.
  function lineageDrawing(value) {
    var column = {}, parents = {}, children = {};
    value.edges.forEach(function (e) { (parents[e.child] = parents[e.child] || []).push(e.parent); (children[e.parent] = children[e.parent] || []).push(e.child); });
    function spread(next, step) {
      for (var wave = [value.artifact.sha256], at = step; wave.length && Math.abs(at) < 200; at += step) {
        var reached = [];
        wave.forEach(function (sha) { (next[sha] || []).forEach(function (other) { if (column[other] === undefined) { column[other] = at; reached.push(other); } }); });
        wave = reached;
      }
    }
    column[value.artifact.sha256] = 0;
    spread(parents, -1);
    spread(children, 1);
    var lowest = Math.min.apply(null, Object.values(column)), filled = {}, place = {};
    var svg = 'http://www.w3.org/2000/svg';
    function make(name, attributes, text) {
      var node = document.createElementNS(svg, name);
      Object.keys(attributes).forEach(function (k) { node.setAttribute(k, attributes[k]); });
      if (text) { node.textContent = text; }
      return node;
    }
    var boxes = value.nodes.filter(function (n) { return column[n.sha256] !== undefined; }).map(function (n) {
      var x = column[n.sha256] - lowest, y = filled[x] = (filled[x] || 0) + 1;
      place[n.sha256] = { x: 10 + 190 * x, y: 10 + 56 * (y - 1) };
      var link = make('a', { href: '#/artifact/' + n.sha256, 'class': n.sha256 === value.artifact.sha256 ? 'self' : '' });
      var p = place[n.sha256];
      link.append(make('rect', { x: p.x, y: p.y, width: 150, height: 42, rx: 6 }), make('text', { x: p.x + 10, y: p.y + 18 }, n.kind),
        make('text', { x: p.x + 10, y: p.y + 33, 'class': 'small' }, n.sha256.slice(0, 12) + (n.job ? '  job ' + n.job : '')));
      return link;
    });
    var columns = Object.keys(filled).length, rows = Math.max.apply(null, Object.values(filled));
    var width = 190 * columns, height = 56 * rows + 14;
    var drawing = make('svg', { width: width, height: height, viewBox: '0 0 ' + width + ' ' + height, role: 'img' });
    value.edges.forEach(function (e) {
      var a = place[e.parent], b = place[e.child];
      if (a && b) { drawing.append(make('path', { d: 'M' + (a.x + 150) + ' ' + (a.y + 21) + ' C' + (a.x + 172) + ' ' + (a.y + 21) + ' ' + (b.x - 22) + ' ' + (b.y + 21) + ' ' + b.x + ' ' + (b.y + 21) })); }
    });
    boxes.forEach(function (box) { drawing.append(box); });
    return el('div.lineage#lineage', { tabindex: 0 }, drawing);
  }

  page.add({
    path: 'artifact', title: 'Artefact', under: 'artifacts',
    draw: function (root, sha) {
      replace(root, el('h1', null, 'Artefact ' + sha.slice(0, 12)));
      page.live(function () { return '/api/artifact?sha256=' + encodeURIComponent(sha); }, function (value, error) {
        if (error) { return replace(root, el('p.note.bad', null, error)); }
        var a = value.artifact;
        replace(
            root, el('h1', null, a.kind + ' ' + a.sha256.slice(0, 12)),
            el('p', null, page.bytes(a.size_bytes) + ', made ' + page.moment(a.created),
               a.job ? [' by ', el('a', {href: '#/job/' + a.job}, 'job ' + a.job)] : null,
               a.pins.length ? ', kept by ' + a.pins.join(', ') : null),
            el('p', null, el('code', null, a.sha256)),
            el('p', null,
               a.kind === 'report' ? [el('a', {href: '#/report/' + a.sha256}, 'read it'), ' · '] : null,
               el('a', {href: '/artifact/' + a.sha256, target: '_blank', rel: 'noopener'}, 'its bytes')),
            el('h2', null,
               'Lineage: made from what is to the left, used by what is to the right' +
                   (value.cut ? ' (cut: there is more)' : '')),
            lineageDrawing(value), Object.keys(a.metadata || {}).length ? el('h2', null, 'Metadata') : null,
            Object.keys(a.metadata || {}).length ? el('pre', null, JSON.stringify(a.metadata, null, 1)) :
                                                   null);
      }, 5000);
    }
  });
})();
