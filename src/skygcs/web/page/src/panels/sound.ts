// The alarm's sounds: two tones by WebAudio, no file, and speech by the computer's own voices. Browsers allow them after a
// person's first gesture only.

let context: AudioContext | null = null;

/** Takes the first gesture on the page as the leave to sound. */
export function beginSound(): void {
  const unlock = (): void => {
    context ??= make();
    void context?.resume().catch(() => undefined); // the next gesture tries again
    if (context?.state === "running") for (const kind of KINDS) removeEventListener(kind, unlock, true);
  };
  for (const kind of KINDS) addEventListener(kind, unlock, { capture: true, passive: true });
}

const KINDS = ["pointerdown", "keydown"] as const;

export function canSound(): boolean {
  return context?.state === "running";
}

/** Two pairs of tones, high and low, in a second. */
export function playAlarm(): void {
  const here = context;
  if (here === null || here.state !== "running") return;
  const begin = here.currentTime + 0.02;
  [0, 0.5].forEach((at) => {
    tone(here, 880, begin + at, 0.18);
    tone(here, 660, begin + at + 0.2, 0.22);
  });
}

function tone(here: AudioContext, hertz: number, at: number, seconds: number): void {
  const source = here.createOscillator();
  const volume = here.createGain();
  source.type = "triangle";
  source.frequency.value = hertz;
  // no click at its ends
  volume.gain.setValueAtTime(0, at);
  volume.gain.linearRampToValueAtTime(0.35, at + 0.02);
  volume.gain.setValueAtTime(0.35, at + seconds - 0.03);
  volume.gain.linearRampToValueAtTime(0, at + seconds);
  source.connect(volume).connect(here.destination);
  source.start(at);
  source.stop(at + seconds);
}

function make(): AudioContext | null {
  try {
    return new AudioContext();
  } catch {
    return null; // a computer without sound
  }
}

/** The voice that says alarms; null: the computer has none. A browser's other voices send the text to a server, and the page
 * works without internet. */
export function ownVoice(): SpeechSynthesisVoice | null {
  if (!("speechSynthesis" in window)) return null;
  const voices = speechSynthesis.getVoices().filter((voice) => voice.localService);
  return voices.find((voice) => voice.lang.startsWith("en")) ?? voices[0] ?? null;
}

export function speak(text: string): void {
  const voice = ownVoice();
  if (voice === null || text === "") return;
  const said = new SpeechSynthesisUtterance(text);
  said.voice = voice;
  said.lang = voice.lang;
  speechSynthesis.cancel(); // the newest alarm counts, not one of a minute ago
  speechSynthesis.speak(said);
}
