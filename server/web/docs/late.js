// When the page is there: what the sidebar's state means to screen readers and to the tab key.
document.getElementById("mdbook-sidebar-toggle").setAttribute("aria-expanded", sidebar === "visible");
document.getElementById("mdbook-sidebar").setAttribute("aria-hidden", sidebar !== "visible");
for (const link of document.querySelectorAll("#mdbook-sidebar a")) {
    link.setAttribute("tabIndex", sidebar === "visible" ? 0 : -1);
}
// A short piece of code stays on one line: browsers would break `--json` after its first hyphen.
for (const code of document.querySelectorAll(".content :is(p, li, td) > code")) {
    if (code.textContent.length <= 20) code.classList.add("whole");
}
