// Draws the plots of a page from the JSON blocks beside them. Each block:
// {labels: [x, series...], rows: [[x, y...]], colors, styles: ["line"|"dashed"|"points"], xlabel, ylabel, logy, range,
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
  document.querySelectorAll('.plot').forEach(function (box) {
    var d = JSON.parse(document.getElementById(box.id + '-data').textContent);
    var series = {};
    d.styles.forEach(function (style, i) {
      var s = { connectSeparatedPoints: !d.breaks };
      if (style === 'dashed') { s.strokePattern = [6, 4]; }
      if (style === 'points') { s.strokeWidth = 0; s.drawPoints = true; s.pointSize = 2.2; }
      series[d.labels[i + 1]] = s;
    });
    new Dygraph(box, d.rows, {
      labels: d.labels, colors: d.colors, series: series, strokeWidth: 1.6,
      xlabel: d.xlabel, ylabel: d.ylabel, logscale: !!d.logy, valueRange: d.range || null,
      underlayCallback: d.bands ? shade(d.bands) : null,
      labelsDiv: document.getElementById(box.id + '-legend'), legend: 'always',
      gridLineColor: dark ? '#303a46' : '#e6eaee', axisLineColor: dark ? '#556' : '#aab3bd',
      axes: { x: { axisLabelFontSize: 11 }, y: { axisLabelFontSize: 11, axisLabelWidth: 58 } },
      xLabelHeight: 16, yLabelWidth: 16, digitsAfterDecimal: 4, maxNumberWidth: 8, rightGap: 8
    });
  });
})();
