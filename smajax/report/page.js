// Draws the figures of the page. Touch scrolls the page instead of zooming a figure; a mouse zooms.
(function () {
  "use strict";
  var figures = JSON.parse(document.getElementById("figures").textContent);
  var coarse = window.matchMedia && window.matchMedia("(pointer: coarse)").matches;
  var config = {
    responsive: true,
    displaylogo: false,
    plotlyServerURL: "", // no data of a report is sent anywhere
    modeBarButtonsToRemove: ["sendChartToCloud", "lasso2d", "select2d"],
    toImageButtonOptions: { format: "svg" }
  };
  figures.forEach(function (figure, k) {
    var place = document.getElementById("picture-" + k);
    figure.layout.dragmode = coarse ? false : "zoom";
    figure.layout.height = place.clientHeight;
    place.textContent = "";
    Plotly.newPlot(place, figure.data, figure.layout, config);
  });
  function fit() {
    document.querySelectorAll(".picture").forEach(function (place) { Plotly.Plots.resize(place); });
  }
  window.addEventListener("beforeprint", fit);
  window.addEventListener("afterprint", fit);
})();
