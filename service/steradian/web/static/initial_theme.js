// Apply the stored theme before the first paint.
try {
  const theme = localStorage.getItem("steradian.theme");
  if (theme === "dark" || theme === "light") document.documentElement.dataset.theme = theme;
} catch {
  // storage is not available: use the system's theme
}
