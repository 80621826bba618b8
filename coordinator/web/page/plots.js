// Plots of the page by Dygraphs, in the page's colours, drawn again when light and dark change.
(function () {
  'use strict';
  var onLight = ['#0072B2', '#D55E00', '#009E73', '#CC79A7'], onDark = ['#56B4E9', '#E69F00', '#2BC48A', '#E29AC4'];
  var dark = window.matchMedia('(prefers-color-scheme: dark)');
  var drawn = [];

  function isDark() { return dark.matches; }

  // spec: {title, labels: [x, series…], rows: [[x, y…]], bars (y is [low, middle, high]), log, ylabel, xlabel}
  function draw(figure, spec) {
    var box = figure.querySelector('.plot');
    return new Dygraph(box, spec.rows, {
      labels: spec.labels, colors: isDark() ? onDark : onLight, strokeWidth: 1.8, drawPoints: true, pointSize: 3,
      customBars: !!spec.bars, logscale: !!spec.log, connectSeparatedPoints: true,
      xlabel: spec.xlabel, ylabel: spec.ylabel, legend: 'always', labelsDiv: figure.querySelector('.legend'),
      gridLineColor: isDark() ? '#303a46' : '#e6eaee', axisLineColor: isDark() ? '#556' : '#aab3bd',
      axes: {
        x: { axisLabelFontSize: 11, pixelsPerLabel: 40, axisLabelFormatter: function (x) { return x === Math.round(x) ? String(x) : ''; } },
        y: { axisLabelFontSize: 11, axisLabelWidth: 58 }
      },
      xRangePad: 12, yRangePad: 8, xLabelHeight: 16, yLabelWidth: 16, digitsAfterDecimal: 4, maxNumberWidth: 8, rightGap: 8
    });
  }

  // A figure element that shows `spec` once it is in the document.
  window.makePlot = function (spec) {
    var figure = document.createElement('figure');
    var caption = document.createElement('figcaption');
    caption.textContent = spec.title;
    var box = document.createElement('div');
    box.className = 'plot';
    var legend = document.createElement('div');
    legend.className = 'legend';
    figure.append(caption, box, legend);
    requestAnimationFrame(function () {
      if (!figure.isConnected) { return; }
      drawn = drawn.filter(function (d) { return d.figure.isConnected || (d.graph.destroy(), false); });
      drawn.push({ figure: figure, spec: spec, graph: draw(figure, spec) });
      figure.dataset.drawn = 'yes';
    });
    return figure;
  };

  dark.addEventListener('change', function () {
    drawn.forEach(function (d) {
      if (!d.figure.isConnected) { return; }
      d.graph.destroy();
      d.graph = draw(d.figure, d.spec);
    });
  });
})();
