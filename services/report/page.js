// Draws the plots of a page from the JSON blocks beside them. Each block:
// {labels: [x, series...], rows: [[x, y...]], colors, styles: ["line"|"dashed"|"points"|"steps"], xlabel, ylabel, logy, range,
//  bands: [[low, high, "missing"|"aside"]], breaks}
(function () {
  var dark = window.matchMedia && window.matchMedia('(prefers-color-scheme: dark)').matches;
  var shades = {
    missing: dark ? 'rgba(255,138,122,0.28)' : 'rgba(180,35,24,0.18)',
    aside: dark ? 'rgba(154,167,180,0.16)' : 'rgba(91,103,117,0.10)'
  };
  function shade(bands) {
    return function (canvas, area, plot) {
      bands.forEach(function (band) {
        var left = plot.toDomXCoord(band[0]), right = plot.toDomXCoord(band[1]);
        canvas.fillStyle = shades[band[2]];
        canvas.fillRect(left, area.y, Math.max(1, right - left), area.h);
      });
    };
  }
  // Shortest text that is as exact as `near`.
  function short(value, near) {
    for (var digits = 1; digits < 17; ++digits) {
      var rounded = Number(value.toPrecision(digits));
      if (Math.abs(rounded - value) <= near) { break; }
    }
    var plain = String(rounded), power = rounded.toExponential();
    return plain.length > 6 && power.length < plain.length ? power : plain;
  }
  // Labels ticks so that no two are alike. What all values share, where they differ late, is taken off them; returns
  // it for the axis' title.
  function label(ticks) {
    var shown = ticks.filter(function (tick) { return tick.label; });
    if (shown.length < 2) { return ''; }
    var values = shown.map(function (tick) { return tick.v; });
    var step = Infinity, low = Math.min.apply(null, values), high = Math.max.apply(null, values);
    for (var i = 1; i < values.length; ++i) { step = Math.min(step, Math.abs(values[i] - values[i - 1])); }
    var near = 1e-3 * step, unit = Math.pow(10, Math.ceil(Math.log10(high - low) - 1e-9));
    var late = low * high > 0 && Math.min(Math.abs(low), Math.abs(high)) > Math.max(1e4 * step, high - low);
    var shared = late ? Math.floor(low / unit + 1e-9) * unit : 0;
    shown.forEach(function (tick) { tick.label = short(tick.v - shared, near); });
    return shared === 0 ? '' : (shared < 0 ? ' + ' : ' \u2212 ') + short(Math.abs(shared), near);
  }
  document.querySelectorAll('.plot').forEach(function (box) {
    var d = JSON.parse(document.getElementById(box.id + '-data').textContent);
    var series = {}, shared = { x: '', y: '' }, points = d.styles.indexOf('points') >= 0;  // whole ones at the edges
    function ticker(axis) {
      return function () {
        var ticks = Dygraph.numericTicks.apply(null, arguments);
        shared[axis] = label(ticks);
        return ticks;
      };
    }
    function showShared() {
      ['x', 'y'].forEach(function (axis) {
        var title = box.querySelector('.dygraph-' + axis + 'label');  // none where the label is empty
        if (title) { title.textContent = d[axis + 'label'] + shared[axis]; }
      });
    }
    d.styles.forEach(function (style, i) {
      var s = { connectSeparatedPoints: !d.breaks };
      if (style === 'dashed') { s.strokePattern = [6, 4]; }
      if (style === 'steps') { s.stepPlot = true; }
      if (style === 'points') { s.strokeWidth = 0; s.drawPoints = true; s.pointSize = d.rows.length < 100 ? 3.2 : 2.2; }
      series[d.labels[i + 1]] = s;
    });
    new Dygraph(box, d.rows, {
      labels: d.labels, colors: d.colors, series: series, strokeWidth: 1.6,
      xlabel: d.xlabel, ylabel: d.ylabel, logscale: !!d.logy, valueRange: d.range || null,
      underlayCallback: d.bands ? shade(d.bands) : null,
      labelsDiv: document.getElementById(box.id + '-legend'), legend: 'always',
      gridLineColor: dark ? '#303a46' : '#e6eaee', axisLineColor: dark ? '#556' : '#aab3bd',
      axes: {
        x: { axisLabelFontSize: 11, ticker: ticker('x') },
        y: { axisLabelFontSize: 11, axisLabelWidth: 58, ticker: ticker('y') }
      },
      drawCallback: showShared, xLabelHeight: 16, yLabelWidth: 16, sigFigs: 6, rightGap: 8,
      xRangePad: points ? 5 : 0, yRangePad: points || d.logy ? 5 : null
    });
  });
})();
