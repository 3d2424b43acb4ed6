// Before anything is drawn: the theme that was chosen here before, else the system's.
try {
  const theme = localStorage.getItem("steradian.theme");
  if (theme === "dark" || theme === "light") document.documentElement.dataset.theme = theme;
} catch {
  // a browser that keeps nothing has the system's
}
