// Before anything is drawn: where the book's files are, and light or dark. mdBook's own template has this inline, which the
// service's content security policy does not allow.
const path_to_root = document.documentElement.dataset.root;
const default_light_theme = "light";
const default_dark_theme = "navy";
window.path_to_searchindex_js = path_to_root + "searchindex.js";

const default_theme = window.matchMedia("(prefers-color-scheme: dark)").matches ? default_dark_theme : default_light_theme;
const html = document.documentElement;
let theme = null;
try { theme = localStorage.getItem("mdbook-theme"); } catch { /* storage is switched off */ }
html.classList.remove(default_light_theme);
html.classList.add(theme ?? default_theme, "js");
