"""The HTML page of a film. It asks for no other file, so that it opens anywhere.

(The page that matplotlib writes loads its buttons' symbols from the network.)
"""

# WAIT: milliseconds a frame. FRAMES: the frames, as data URLs.
PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>A motion</title>
<style>
  .film { display: inline-block; font: 14px sans-serif; }
  .film img { display: block; max-width: 100%; }
  .film div { display: flex; gap: 8px; }
  .film input { flex: 1; }
</style>
</head>
<body>
<div class="film">
  <img alt="a frame of the motion">
  <div>
    <button type="button">Pause</button>
    <input type="range" min="0" value="0" aria-label="frame">
  </div>
</div>
<script>
(function () {
  const frames = [
FRAMES
  ];
  const film = document.querySelector(".film");
  const image = film.querySelector("img");
  const button = film.querySelector("button");
  const slider = film.querySelector("input");
  let timer = null;
  slider.max = frames.length - 1;
  function show(k) {
    image.src = frames[k];
    slider.value = k;
  }
  function play(on) {
    clearInterval(timer);
    timer = on ? setInterval(() => show((+slider.value + 1) % frames.length), WAIT) : null;
    button.textContent = on ? "Pause" : "Play";
  }
  button.onclick = () => play(timer === null);
  slider.oninput = () => { play(false); show(+slider.value); };
  show(0);
  play(true);
})();
</script>
</body>
</html>
"""
