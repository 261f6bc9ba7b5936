// What the page says, in words.
export const EXPLANATIONS = {
  outline: 'Inside the line: what the camera sees. Outside: what the model remembers of the room.',
  dim: 'Bright: what the camera sees. Dark: what the model remembers of the room.',
  confidence: 'Outside the line the model fills in; the stronger the colour, the less sure it is.',
  camera: 'Only what the camera sees; what the model fills in is hidden.',
};
const ROUGH_EXPLANATIONS = {
  ...EXPLANATIONS,
  outline: 'Inside the line: what the camera sees. Outside: a rough guess of the network alone.',
  dim: 'Bright: what the camera sees. Dark: a rough guess of the network alone.',
};
// Why there is no connection.
const CLOSED = {
  full: { title: 'No place left', text: 'As many viewers as allowed are watching.' },
  asleep: { title: 'Asleep', text: 'This page was hidden for a minute and gave its place away.' },
  lost: { title: 'Disconnected', text: 'Trying to reach the viewer.' },
};
const UNKNOWN_FRAME = 'The camera\'s frame is not known yet: any part of the picture may be made up.';

// What the page says about the stream: a short title, and a sentence.
// `age`: of the picture, ms; null without one.
export function judge(state, age) {
  const old = age === null ? '' : ` This picture is ${seconds(age)} old.`;
  if (!state.connected) {
    const { title, text } = CLOSED[state.closed];
    return { name: state.closed, title, text: state.closed === 'lost' ? text + old : text };
  }
  if (age !== null && state.status.playback && !state.status.playback.playing) {
    return state.status.playback.ended ? { name: 'ended', title: 'End of the recording', text: '' }
      : { name: 'paused', title: 'Paused', text: '' };
  }
  if (age !== null && age <= state.staleMs) {
    return state.status.span ? { name: 'recording', title: 'Recording', text: '' }
      : { name: 'live', title: 'Live', text: '' };
  }
  if (state.status.waiting) {
    return { name: 'waiting', title: 'No pictures', text: `${state.status.waiting}.${old}` };
  }
  if (age === null) return { name: 'waiting', title: 'No pictures', text: 'None has come yet.' };
  return { name: 'stale', title: 'Stale', text: old };
}

// Whether pictures come as they should.
export function plays(verdict) {
  return ['live', 'recording', 'paused', 'ended'].includes(verdict.name);
}

// What the node complains of, in words; empty when all is well.
export function complaint({ level = 0, message }) {
  return level === 0 ? '' : `${level === 1 ? 'Warning' : 'Error'} of the node: ${message}`;
}

// What lies outside of the camera's frame; `trust` in it, see paint().
export function explanation({ picture, way }, trust) {
  const known = picture === null || picture.seen !== null;
  return known ? (trust === 'rough' ? ROUGH_EXPLANATIONS : EXPLANATIONS)[way]
    : UNKNOWN_FRAME;
}

// Where in the bag the picture stands, and when it was recorded.
export function bagTime({ status: { span }, picture }) {
  const recorded = picture?.recorded;
  if (!span || !recorded) return '–';
  return `${clockTime(recorded - span[0])} of ${clockTime(span[1] - span[0])}`;
}

export function seconds(ms) {
  return `${(ms / 1000).toFixed(1)} s`;
}

export function clockTime(s) {
  const tenths = Math.round(10 * s);  // First, or 59.97 s were 0:60.0.
  const minutes = Math.floor(tenths / 600);
  return `${minutes}:${((tenths - 600 * minutes) / 10).toFixed(1).padStart(4, '0')}`;
}
