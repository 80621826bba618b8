// Draws the plots of a page from the JSON blocks beside them. Each block:
// {labels: [x, series...], rows: [[x, y...]], colors, styles: ["line"|"dashed"|"points"], xlabel, ylabel, logy, range}
(function () {
  var dark = window.matchMedia && window.matchMedia('(prefers-color-scheme: dark)').matches;
  document.querySelectorAll('.plot').forEach(function (box) {
    var d = JSON.parse(document.getElementById(box.id + '-data').textContent);
    var series = {};
    d.styles.forEach(function (style, i) {
      var s = { connectSeparatedPoints: true };
      if (style === 'dashed') { s.strokePattern = [6, 4]; }
      if (style === 'points') { s.strokeWidth = 0; s.drawPoints = true; s.pointSize = 2.2; }
      series[d.labels[i + 1]] = s;
    });
    new Dygraph(box, d.rows, {
      labels: d.labels, colors: d.colors, series: series, strokeWidth: 1.6,
      xlabel: d.xlabel, ylabel: d.ylabel, logscale: !!d.logy, valueRange: d.range || null,
      labelsDiv: document.getElementById(box.id + '-legend'), legend: 'always',
      gridLineColor: dark ? '#303a46' : '#e6eaee', axisLineColor: dark ? '#556' : '#aab3bd',
      axes: { x: { axisLabelFontSize: 11 }, y: { axisLabelFontSize: 11, axisLabelWidth: 58 } },
      xLabelHeight: 16, yLabelWidth: 16, digitsAfterDecimal: 4, maxNumberWidth: 8, rightGap: 8
    });
  });
})();
