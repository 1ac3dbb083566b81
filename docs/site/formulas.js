// Formulas stand in the texts of notebooks, and a dollar elsewhere is a dollar.
window.MathJax = {
  tex: { inlineMath: [["$", "$"]], displayMath: [["$$", "$$"]] },
  options: { ignoreHtmlClass: ".*|", processHtmlClass: "jp-RenderedMarkdown" },
};
