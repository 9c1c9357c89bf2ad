//! A short sound for alarms, if the operator wants one. It is made here and played by a program of
//! the system: `pw-play`, `paplay` or `aplay` under Linux, `afplay` under macOS, PowerShell under
//! Windows. A library that plays would link ALSA, whose headers then are needed to build the window,
//! for one beep; and where there is no sound at all, as on many a panel computer, the window says so
//! instead of failing to start.

use std::{
    f64::consts::TAU,
    fs::File,
    io::Write as _,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

/// Samples in a second of the sound.
const RATE_HZ: u32 = 22_050;

/// Frequency and length of each tone; 0 Hz is a pause.
const TONES: [(f64, f64); 3] = [(880.0, 0.15), (0.0, 0.05), (660.0, 0.25)];

/// Loudness of the sound, a share of the loudest.
const LOUDNESS: f64 = 0.4;

/// How long a tone swells, and how long it fades, s.
const SWELL_S: f64 = 0.01;

/// How long a player may take, far more than the sound: one that waits for a device which somebody else
/// has would keep all that come after it silent.
const PLAYER_MAX: Duration = Duration::from_secs(10);

/// Names that are tried for the file.
const NAMES_TRIED: u32 = 100;

/// A program that plays a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Player {
    /// Its name.
    pub program: String,
    /// Its arguments; `{}` becomes the file's name.
    pub arguments: Vec<String>,
}

impl Player {
    /// Returns a player.
    pub fn new(program: &str, arguments: &[&str]) -> Self {
        let arguments = arguments.iter().map(|argument| (*argument).to_owned());
        Self {
            program: program.to_owned(),
            arguments: arguments.collect(),
        }
    }

    fn start(&self, file: &Path) -> std::io::Result<Child> {
        let file = file.display().to_string();
        let arguments = self.arguments.iter();
        Command::new(&self.program)
            .args(arguments.map(|argument| argument.replace("{}", &file)))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
    }
}

/// See the module.
#[derive(Debug)]
pub struct Sound {
    players: Vec<Player>,
    // The one that is at work, or worked last.
    player: usize,
    playing: Option<(Child, Instant)>,
    player_max: Duration,
    file: Option<PathBuf>,
    failed: Option<String>,
}

impl Default for Sound {
    fn default() -> Self {
        let script = "(New-Object Media.SoundPlayer '{}').PlaySync()";
        Self::with(match std::env::consts::OS {
            "macos" => vec![Player::new("afplay", &["{}"])],
            "windows" => vec![Player::new(
                "powershell",
                &["-NoProfile", "-Command", script],
            )],
            _ => vec![
                Player::new("pw-play", &["{}"]),
                Player::new("paplay", &["{}"]),
                Player::new("aplay", &["-q", "{}"]),
            ],
        })
    }
}

impl Sound {
    /// Plays by the first of these that can.
    pub fn with(players: Vec<Player>) -> Self {
        Self {
            players,
            player: 0,
            playing: None,
            player_max: PLAYER_MAX,
            file: None,
            failed: None,
        }
    }

    /// Begins to play, if it does not play already.
    pub fn play(&mut self) {
        if self.playing.is_none() {
            self.failed = None;
            self.start();
        }
    }

    /// Looks whether a player ended, and takes the next one if it could not play. Returns whether
    /// one is at work.
    pub fn poll(&mut self) -> bool {
        let Some((child, began)) = &mut self.playing else {
            return false;
        };
        let is_stuck = began.elapsed() > self.player_max;
        match child.try_wait() {
            Ok(None) if !is_stuck => return true,
            Ok(Some(status)) if status.success() => self.playing = None,
            Ok(None) => {
                end(child);
                self.playing = None;
                self.player += 1;
                self.start();
            }
            Ok(Some(_)) | Err(_) => {
                self.playing = None;
                self.player += 1;
                self.start();
            }
        }
        self.playing.is_some()
    }

    /// Returns whether a player is at work, as far as was looked.
    pub fn is_playing(&self) -> bool {
        self.playing.is_some()
    }

    /// Waits until no player is at work.
    pub fn wait(&mut self) {
        while let Some((child, _)) = &mut self.playing {
            // Whether it went well is looked at next.
            let _ = child.wait();
            self.poll();
        }
    }

    /// Returns why nothing can be heard.
    pub fn failed(&self) -> Option<&str> {
        self.failed.as_deref()
    }

    /// Starts the first player, from the present one on, that can be started.
    fn start(&mut self) {
        let file = match self.file() {
            Ok(file) => file,
            Err(error) => {
                self.failed = Some(format!("no file for the sound: {error}"));
                return;
            }
        };
        while let Some(player) = self.players.get(self.player) {
            match player.start(&file) {
                Ok(child) => {
                    self.playing = Some((child, Instant::now()));
                    return;
                }
                Err(_) => self.player += 1,
            }
        }
        let names: Vec<&str> = self
            .players
            .iter()
            .map(|player| player.program.as_str())
            .collect();
        self.failed = Some(format!("nothing here can play it: {}", names.join(", ")));
        self.player = 0;
    }

    /// Returns the file with the sound; makes it at the first time.
    fn file(&mut self) -> std::io::Result<PathBuf> {
        if let Some(file) = &self.file {
            return Ok(file.clone());
        }
        let mut last = std::io::Error::from(std::io::ErrorKind::AlreadyExists);
        for number in 0..NAMES_TRIED {
            let name = format!("stepfleet-alarm-{}-{number}.wav", std::process::id());
            let path = std::env::temp_dir().join(name);
            // Never what somebody else has put there.
            match File::create_new(&path) {
                Ok(mut file) => {
                    file.write_all(&wave())?;
                    self.file = Some(path.clone());
                    return Ok(path);
                }
                Err(error) => last = error,
            }
        }
        Err(last)
    }
}

impl Drop for Sound {
    fn drop(&mut self) {
        if let Some((mut child, _)) = self.playing.take() {
            end(&mut child);
        }
        if let Some(file) = self.file.take() {
            // One small file that stays does no harm.
            let _ = std::fs::remove_file(file);
        }
    }
}

fn end(child: &mut Child) {
    // It may have ended by itself meanwhile.
    let _ = child.kill();
    let _ = child.wait();
}

/// Returns the sound, sample by sample.
fn samples() -> Vec<i16> {
    let mut samples = Vec::new();
    for (frequency_hz, length_s) in TONES {
        let count = (length_s * f64::from(RATE_HZ)) as u32;
        for number in 0..count {
            let at_s = f64::from(number) / f64::from(RATE_HZ);
            // Without clicks: each tone swells and fades.
            let edge = (at_s.min(length_s - at_s) / SWELL_S).min(1.0);
            let value = (TAU * frequency_hz * at_s).sin() * edge * LOUDNESS;
            samples.push((value * f64::from(i16::MAX)) as i16);
        }
    }
    samples
}

/// Returns the sound as a RIFF/WAVE file: PCM, 16 bits, one channel.
fn wave() -> Vec<u8> {
    let samples: Vec<u8> = samples().into_iter().flat_map(i16::to_le_bytes).collect();
    let size = samples.len() as u32;
    let mut file = Vec::new();
    file.extend(b"RIFF");
    file.extend((36 + size).to_le_bytes());
    file.extend(b"WAVEfmt ");
    file.extend(16_u32.to_le_bytes());
    file.extend(1_u16.to_le_bytes());
    file.extend(1_u16.to_le_bytes());
    file.extend(RATE_HZ.to_le_bytes());
    file.extend((RATE_HZ * 2).to_le_bytes());
    file.extend(2_u16.to_le_bytes());
    file.extend(16_u16.to_le_bytes());
    file.extend(b"data");
    file.extend(size.to_le_bytes());
    file.extend(samples);
    file
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn the_first_player_that_can_play_gets_a_whole_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let copy = folder.path().join("heard.wav");
        let mut sound = Sound::with(vec![
            Player::new("/nowhere/pw-play", &["{}"]),
            Player::new("false", &["{}"]),
            Player::new("cp", &["{}", &copy.display().to_string()]),
        ]);
        sound.play();
        sound.play();
        sound.wait();
        assert_eq!(sound.failed(), None);
        let heard = std::fs::read(&copy).expect("played");
        assert_eq!(heard, wave());
        assert_eq!(
            u32::from_le_bytes([heard[4], heard[5], heard[6], heard[7]]) as usize + 8,
            heard.len()
        );
        let file = sound.file.clone().expect("made");
        drop(sound);
        assert!(!file.exists(), "it is taken away");
    }

    #[test]
    fn a_player_that_hangs_is_ended_and_the_next_one_plays() {
        let folder = tempfile::tempdir().expect("a folder");
        let copy = folder.path().join("heard.wav");
        let mut sound = Sound::with(vec![
            Player::new("sleep", &["3600"]),
            Player::new("cp", &["{}", &copy.display().to_string()]),
        ]);
        sound.play();
        assert!(sound.poll(), "it may take its time");
        sound.player_max = Duration::ZERO;
        sound.poll();
        sound.player_max = PLAYER_MAX;
        sound.wait();
        assert_eq!(sound.failed(), None);
        assert_eq!(std::fs::read(&copy).expect("played"), wave());
    }

    /// How much of a frequency is in some samples: 1 if they are a full sine of it and nothing else.
    fn share_of(samples: &[i16], frequency_hz: f64) -> f64 {
        let (mut cosine, mut sine) = (0.0, 0.0);
        for (number, sample) in (0..).zip(samples) {
            let angle = TAU * frequency_hz * f64::from(number) / f64::from(RATE_HZ);
            let value = f64::from(*sample) / f64::from(i16::MAX);
            cosine += value * angle.cos();
            sine += value * angle.sin();
        }
        2.0 * cosine.hypot(sine) / samples.len() as f64
    }

    #[test]
    fn the_sound_is_two_tones_with_a_pause_loud_enough_and_without_a_click() {
        let samples = samples();
        let length_s: f64 = TONES.iter().map(|(_, length_s)| length_s).sum();
        let ideal = length_s * f64::from(RATE_HZ);
        assert!((samples.len() as f64 - ideal).abs() <= 3.0);
        let loudest = samples.iter().map(|sample| sample.unsigned_abs()).max();
        let bound = LOUDNESS * f64::from(i16::MAX);
        let loudest = f64::from(loudest.expect("samples"));
        assert!(loudest <= bound && loudest > 0.98 * bound, "{loudest}");
        let mut rest = &samples[..];
        for (frequency_hz, length_s) in TONES {
            let (tone, behind) = rest.split_at((length_s * f64::from(RATE_HZ)) as usize);
            rest = behind;
            if frequency_hz == 0.0 {
                assert!(tone.iter().all(|sample| *sample == 0), "a pause");
                continue;
            }
            let own = share_of(tone, frequency_hz);
            assert!((0.9 * LOUDNESS..=LOUDNESS).contains(&own), "{own}");
            for other_hz in [440.0, 660.0, 880.0, 1_760.0] {
                let other = share_of(tone, other_hz);
                assert!(other_hz == frequency_hz || other < own / 30.0, "{other}");
            }
            // Neighbours differ by no more than the steepest part of the sine.
            let steepest = TAU * frequency_hz / f64::from(RATE_HZ) * bound + bound / 100.0;
            let jump = tone.windows(2).map(|two| two[0].abs_diff(two[1])).max();
            assert!(f64::from(jump.expect("samples")) <= steepest);
            let ends = [tone[0], tone[tone.len() - 1]];
            assert!(ends.iter().all(|end| end.unsigned_abs() < 400), "{ends:?}");
        }
        assert!(rest.is_empty());
    }

    #[test]
    fn the_file_says_what_is_in_it() {
        let file = wave();
        let number = |at: usize| u16::from_le_bytes([file[at], file[at + 1]]);
        let long = |at: usize| u32::from(number(at)) + (u32::from(number(at + 2)) << 16);
        assert_eq!((&file[..4], &file[8..16]), (&b"RIFF"[..], &b"WAVEfmt "[..]));
        assert_eq!(
            (number(20), number(22), number(34)),
            (1, 1, 16),
            "PCM, mono"
        );
        assert_eq!((long(24), long(28)), (RATE_HZ, 2 * RATE_HZ));
        assert_eq!(long(40) as usize, 2 * samples().len());
        assert_eq!(long(4) as usize + 8, file.len());
    }

    #[test]
    fn without_a_player_it_says_so_and_tries_again_later() {
        let mut sound = Sound::with(vec![
            Player::new("/nowhere/aplay", &["{}"]),
            Player::new("false", &["{}"]),
        ]);
        for _ in 0..2 {
            sound.play();
            sound.wait();
            let why = sound.failed().expect("nothing plays");
            assert!(why.contains("/nowhere/aplay, false"), "{why}");
        }
    }
}
