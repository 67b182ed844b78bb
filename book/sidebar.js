// Before the sidebar is drawn: whether it shows. On narrow screens it is opened by its button alone.
const sidebar_toggle = document.getElementById("mdbook-sidebar-toggle-anchor");
let sidebar = "hidden";
if (document.body.clientWidth >= 1080) {
    try { sidebar = localStorage.getItem("mdbook-sidebar") || "visible"; } catch { sidebar = "visible"; }
}
sidebar_toggle.checked = sidebar === "visible";
html.classList.toggle("sidebar-visible", sidebar === "visible");
