// The page's frame: elements, asking the coordinator, and which view is shown. Text of others (names, logs,
// reasons) only ever becomes text nodes. A view is {path, title, draw(root, argument)}; draw returns nothing and
// asks with page.live(), which goes on until another view is shown.
var page = (function () {
  'use strict';
  var kPeriodMs = 1000;
  var views = {};
  var generation = 0;  // grows with every view shown: what was asked for an older one is dropped
  var lastAnswer = 0;

  // el('td.num', {title: 'x'}, 'text', node…); 'div.plots#id' has a class and an id.
  function el(name, attributes) {
    var parts = /^([a-z0-9]+)((?:\.[\w-]+)*)(?:#([\w-]+))?$/.exec(name);
    var node = document.createElement(parts[1]);
    if (parts[2]) { node.className = parts[2].slice(1).split('.').join(' '); }
    if (parts[3]) { node.id = parts[3]; }
    Object.keys(attributes || {}).forEach(function (key) {
      var value = attributes[key];
      if (key.slice(0, 2) === 'on') { node.addEventListener(key.slice(2), value); } else if (value !== null && value !== undefined && value !== false) { node.setAttribute(key, value); }
    });
    Array.prototype.slice.call(arguments, 2).forEach(function add(child) {
      if (Array.isArray(child)) { child.forEach(add); } else if (child !== null && child !== undefined) { node.append(child); }
    });
    return node;
  }

  // columns: [{name, num}]; rows: [{key, cells}] — a cell is text or an element.
  function table(columns, rows, attributes) {
    var head = el('tr', null, columns.map(function (c) { return el(c.num ? 'th.num' : 'th', null, c.name); }));
    var body = rows.map(function (row) {
      return el('tr', row.attributes, row.cells.map(function (cell, i) {
        return el(columns[i].num ? 'td.num' : 'td', { 'data-label': columns[i].name }, cell === '' ? null : cell);
      }));
    });
    return el('table.stack', attributes, el('thead', null, head), el('tbody', null, body));
  }

  function badge(state) { return el('span.badge.' + state, null, state); }

  function bar(done, running, failed) {
    var piece = function (kind, share) { return share > 0 ? el('i.' + kind, { style: 'width:' + (100 * share).toFixed(2) + '%' }) : null; };
    return el('div.bar', { role: 'progressbar', 'aria-valuenow': Math.round(100 * done), 'aria-valuemin': 0, 'aria-valuemax': 100 },
      piece('done', done), piece('run', running), piece('fail', failed));
  }

  function duration(s) {
    if (s === null || s === undefined || !(s >= 0)) { return '–'; }
    if (s < 10) { return s.toFixed(1) + ' s'; }
    if (s < 90) { return Math.round(s) + ' s'; }
    if (s < 5400) { return Math.floor(s / 60) + ' min ' + String(Math.floor(s % 60)).padStart(2, '0') + ' s'; }
    if (s < 172800) { return Math.floor(s / 3600) + ' h ' + String(Math.floor(s % 3600 / 60)).padStart(2, '0') + ' min'; }
    return Math.round(s / 86400) + ' days';
  }
  // A job's kind and name in one, without saying a word twice.
  function what(job) {
    return !job.name || job.name === job.kind ? job.kind : job.name.indexOf(job.kind) === 0 ? job.name : job.kind + ' · ' + job.name;
  }
  function moment(text) { return text ? text.slice(0, 19).replace('T', ' ') : '–'; }
  function number(x) {
    if (x === null || x === undefined) { return '–'; }
    var size = Math.abs(x);
    return size !== 0 && (size < 1e-3 || size >= 1e6) ? x.toExponential(3) : String(+x.toPrecision(5));
  }
  function bytes(n) {
    var units = ['B', 'KB', 'MB', 'GB', 'TB'], i = 0;
    while (n >= 1000 && i < 4) { n /= 1000; ++i; }
    return (i === 0 ? n : n.toPrecision(3)) + ' ' + units[i];
  }
  function artifact(sha, text) { return el('a', { href: '#/artifact/' + sha }, text || sha.slice(0, 12)); }

  function showLink() {
    var link = document.getElementById('link');
    var silent = (Date.now() - lastAnswer) / 1000;
    link.className = silent < 5 ? 'live' : 'lost';
    link.textContent = silent < 5 ? 'live' : lastAnswer === 0 ? 'no answer' : 'no answer for ' + duration(silent);
  }

  function ask(path) {
    return fetch(path, { credentials: 'same-origin' }).then(function (reply) {
      if (reply.status === 401) { location.reload(); }
      return reply.json().then(function (value) {
        if (!reply.ok) { throw new Error(value.error || reply.statusText); }
        lastAnswer = Date.now();
        return value;
      });
    });
  }

  // Asks for `path()` now and every period while the view is shown, and calls `draw` where the answer is another.
  function live(path, draw, periodMs) {
    var mine = generation, last = null;
    function turn() {
      if (mine !== generation) { return; }
      if (document.hidden) { return setTimeout(turn, kPeriodMs); }
      var asked = path();
      ask(asked).then(function (value) {
        var text = asked + JSON.stringify(value);
        if (mine === generation && asked === path() && text !== last) { last = text; draw(value, null); }
      }).catch(function (error) {
        if (mine === generation && last === null) { draw(null, error.message); }
      }).then(function () {
        showLink();
        setTimeout(turn, periodMs || kPeriodMs);
      });
    }
    turn();
    return turn;
  }

  function replace(node) {
    node.replaceChildren.apply(node, Array.prototype.slice.call(arguments, 1).filter(function (c) { return c !== null && c !== undefined; }));
  }

  function show() {
    ++generation;
    var parts = (location.hash || '#/jobs').slice(2).split('/').map(decodeURIComponent);
    var view = views[parts[0] || 'jobs'];
    var root = document.getElementById('view');
    document.querySelectorAll('nav a').forEach(function (a) {
      a.classList.toggle('here', a.getAttribute('href') === '#/' + ((view && view.under) || parts[0] || 'jobs'));
    });
    replace(root);
    if (!view) { return replace(root, el('p', null, 'There is no such view.')); }
    document.title = view.title + (parts[1] ? ' ' + parts[1].slice(0, 12) : '') + ' · RealityGrad';
    view.draw(root, parts[1]);
    window.scrollTo(0, 0);
  }

  function watchStatus() {
    ask('/api/status').then(function (s) {
      var trouble = document.getElementById('trouble');
      trouble.hidden = !s.trouble;
      trouble.textContent = s.trouble;
      document.getElementById('about').textContent = 'coordinator ' + s.version + ' · ' + s.database + ' · up ' + duration(s.uptime_s) + ' · times in UTC';
    }).catch(function () {}).then(function () { showLink(); setTimeout(watchStatus, 2000); });
  }

  window.addEventListener('hashchange', show);
  document.addEventListener('DOMContentLoaded', function () { show(); watchStatus(); });
  return {
    add: function (view) { views[view.path] = view; }, el: el, table: table, badge: badge, bar: bar, duration: duration, moment: moment,
    what: what, number: number, bytes: bytes, artifact: artifact, ask: ask, live: live, replace: replace
  };
})();
