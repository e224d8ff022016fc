// Draws every picture of the page; a finger pans the page and not the picture, a mouse zooms into it.
(function () {
  "use strict";
  var figures = JSON.parse(document.getElementById("figures").textContent);
  var coarse = window.matchMedia && window.matchMedia("(pointer: coarse)").matches;
  var config = {
    responsive: true,
    displaylogo: false,
    plotlyServerURL: "", // nothing of a report leaves the machine
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
