// @ts-check
// Spectrum of an A-line, relative to its maximum.

/**
 * @param {ArrayLike<number>} samples @param {number} interval between them, in seconds
 * @returns {{levels: Float64Array, step: number, peak: number}} dB, Hz between them, Hz of the strongest
 */
export function spectrum(samples, interval) {
  const size = 2 ** Math.ceil(Math.log2(Math.max(2, samples.length)));
  const real = new Float64Array(size);
  const imaginary = new Float64Array(size);
  let mean = 0;
  for (let n = 0; n < samples.length; n++) mean += samples[n] / samples.length;
  for (let n = 0; n < samples.length; n++) real[n] = (samples[n] - mean) * Math.sin((Math.PI * (n + 0.5)) / samples.length) ** 2;
  fft(real, imaginary);
  const levels = Float64Array.from({ length: size / 2 }, (_, k) => Math.hypot(real[k], imaginary[k]));
  const strongest = levels.reduce((best, one, k) => (one > levels[best] ? k : best), 0);
  const maxLevel = levels[strongest] || 1;
  const step = 1 / (size * interval);
  return { levels: levels.map((one) => 20 * Math.log10(Math.max(one / maxLevel, 1e-6))), step, peak: strongest * step };
}

/** Compute the FFT in place; the length is a power of two. @param {Float64Array} real @param {Float64Array} imaginary */
function fft(real, imaginary) {
  const size = real.length;
  for (let n = 1, mirrored = 0; n < size; n++) {
    let bit = size >> 1;
    for (; mirrored & bit; bit >>= 1) mirrored ^= bit;
    mirrored ^= bit;
    if (n < mirrored) [real[n], real[mirrored]] = [real[mirrored], real[n]];
  }
  for (let half = 1; half < size; half *= 2) {
    for (let k = 0; k < half; k++) {
      const [cosine, sine] = [Math.cos((-Math.PI * k) / half), Math.sin((-Math.PI * k) / half)];
      for (let n = k; n < size; n += 2 * half) {
        const other = n + half;
        const re = real[other] * cosine - imaginary[other] * sine;
        const im = real[other] * sine + imaginary[other] * cosine;
        [real[other], imaginary[other]] = [real[n] - re, imaginary[n] - im];
        [real[n], imaginary[n]] = [real[n] + re, imaginary[n] + im];
      }
    }
  }
}
