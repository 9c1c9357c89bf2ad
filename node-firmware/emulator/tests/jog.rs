//! Jogging by hand: what is asked for on the key `jog`, what is answered, what the pins do; judged by
//! the oracle.

mod bench;

use bench::{
    Bench, config,
    motor::{Random, seeds, steps_of},
};
use emulator::EmulatorConfig;
use keys::{AxisId, Command, LocalMicros, NodeState, NodeTopic, StopMode};
use motion::{SoftLimits, io::input::Switch};

const X: AxisId = AxisId(0);
const Y: AxisId = AxisId(1);

/// What a node answers: JSON, or the JSON of a refusal.
type Answer = Result<serde_json::Value, serde_json::Value>;

impl Bench {
    fn ask(&mut self, request: &str) -> Answer {
        let number = 77_u32;
        let mut payload = number.to_le_bytes().to_vec();
        payload.extend(request.bytes());
        self.node.handle(NodeTopic::Jog, &payload, self.now);
        let told = self.node.outbox(self.now);
        let mut answers = told.iter().filter(|out| out.topic == NodeTopic::Jog);
        let answer = answers.next().expect("every request is answered");
        assert!(answers.next().is_none(), "once");
        let json = serde_json::from_slice(&answer.payload).expect("JSON");
        match answer.suffix.as_str() {
            "77" => Ok(json),
            "!77" => Err(json),
            other => panic!("{other}"),
        }
    }

    fn jog(&mut self, request: &str) -> serde_json::Value {
        let answer = self.ask(request);
        answer.unwrap_or_else(|error| panic!("{request}: {error}"))
    }

    fn refusal(&mut self, request: &str) -> String {
        let error = self.ask(request).expect_err("it is refused");
        let text = |field: &str| error["error"][field].as_str().expect("a text").to_owned();
        format!("{}: {}", text("code"), text("message"))
    }

    fn position(&self, axis: AxisId) -> i64 {
        self.node.status().axes[axis.index()].position_steps
    }
}

fn bench() -> Bench {
    Bench::new(config())
}

fn state(bench: &Bench) -> NodeState {
    bench.node.status().state
}

#[test]
fn a_run_goes_on_while_it_is_renewed_and_rests_by_its_ramp_when_nobody_does() {
    let mut bench = bench();
    let answer = bench.jog(r#"{"axis":0,"run":"forward","speed_hz":1000,"accel":4000}"#);
    assert_eq!(answer["lease_ms"], 500);
    assert_eq!(answer["moving"], true);
    let renew = format!(r#"{{"renew":{}}}"#, answer["jog"]);
    for _ in 0..20 {
        bench.run_for(300_000);
        assert_eq!(bench.jog(&renew)["position"], bench.position(X));
        assert_eq!(state(&bench), NodeState::Running);
    }
    let renewed_at = bench.now.0;
    bench.run_for(3_000_000);
    assert_eq!(state(&bench), NodeState::Idle);
    let at = bench.position(X);
    assert!(at > 5_500, "{at}");
    // A renewal that comes late moves nothing.
    assert_eq!(
        bench.refusal(&renew),
        format!("not_allowed: jog {} is over", answer["jog"])
    );
    bench.run_for(1_000_000);
    assert_eq!(bench.position(X), at);
    let life = bench.judged();
    let last = steps_of(&life, X).last().expect("it moved").0;
    // The lease, and 1000 Hz by 4000 steps/s².
    let rests = renewed_at as f64 / 1e6 + 0.5 + 0.25;
    assert!((last - rests).abs() < 0.025, "{last}, {rests}");
    assert!(
        bench
            .lines
            .iter()
            .any(|line| line.contains("nobody has renewed"))
    );
}

#[test]
fn a_move_to_a_place_has_no_lease_and_a_single_step_is_one() {
    let mut bench = bench();
    let answer = bench.jog(r#"{"axis":1,"to":-5000,"speed_hz":2000,"accel":10000,"jerk":100000}"#);
    assert_eq!(answer["lease_ms"], serde_json::Value::Null);
    bench.run_for(5_000_000);
    assert_eq!(bench.position(Y), -5_000);
    bench.jog(r#"{"axis":1,"by":1,"speed_hz":100,"accel":1000}"#);
    bench.run_for(500_000);
    bench.jog(r#"{"axis":1,"by":-1,"speed_hz":100,"accel":1000}"#);
    bench.jog(r#"{"axis":1,"by":-1,"speed_hz":100,"accel":1000}"#);
    bench.run_for(500_000);
    assert_eq!(bench.position(Y), -5_001);
    let life = bench.judged();
    assert_eq!(life.drives.len(), 3);
    // The queue goes on from there.
    bench.order([
        Command::SetPosition {
            axis: Y,
            position_steps: 10,
        },
        Command::Move {
            axis: Y,
            delay_us: 500,
            steps: 5,
        },
    ]);
    bench.run_to_rest();
    bench.jog(r#"{"axis":1,"to":0,"speed_hz":100,"accel":1000}"#);
    bench.run_for(2_000_000);
    assert_eq!(bench.position(Y), 0);
    bench.judged();
}

#[test]
fn an_s_curve_by_hand_keeps_its_jerk_at_the_pins_and_more_is_found() {
    let mut bench = bench();
    let by_hand = |bench: &mut Bench, what: &str, speed_hz: u32, wait_us: u64| {
        bench.jog(&format!(
            r#"{{"axis":0,{what},"speed_hz":{speed_hz},"accel":8000,"jerk":40000}}"#
        ));
        bench.run_for(wait_us);
    };
    // Another speed and another target in flight, also while it speeds up or slows down; it turns.
    by_hand(&mut bench, r#""to":9000"#, 3_000, 350_000);
    by_hand(&mut bench, r#""to":9000"#, 5_000, 600_000);
    by_hand(&mut bench, r#""to":9000"#, 1_500, 200_000);
    by_hand(&mut bench, r#""to":4000"#, 4_000, 300_000);
    by_hand(&mut bench, r#""to":-2000"#, 4_000, 9_000_000);
    assert_eq!(bench.position(X), -2_000);
    let mut life = bench.judged();
    assert_eq!(life.drives.len(), 1);
    for order in &mut life.drives[0].orders {
        order.shape = keys::command::RampShape::Jerk {
            jerk_hz_per_s2: 39_000,
        };
    }
    let found = emulator::oracle::check_life(&life).expect_err("it has more");
    let found = found[0].to_string();
    assert!(found.contains("steps/s³"), "{found}");
}

#[test]
fn speed_target_and_direction_change_in_flight() {
    let mut bench = bench();
    bench.jog(r#"{"axis":0,"run":"forward","speed_hz":1000,"accel":4000,"lease_ms":5000}"#);
    bench.run_for(1_000_000);
    // Faster, and still on and on: what is relative to a run keeps its lease.
    let faster = bench.jog(r#"{"axis":0,"by":0,"speed_hz":3000,"accel":4000}"#);
    assert_eq!(faster["lease_ms"], 5_000);
    bench.run_for(1_000_000);
    let speed = bench.node.status().axes[0].speed_mhz;
    assert!((speed - 3_000_000).abs() < 500, "{speed}");
    bench.jog(r#"{"axis":0,"accelerate":-6000,"speed_hz":2000}"#);
    bench.run_for(200_000);
    let coast = bench.jog(r#"{"axis":0,"coast":true,"lease_ms":2000}"#);
    assert_eq!(coast["lease_ms"], 2_000);
    bench.run_for(100_000);
    let speed = bench.node.status().axes[0].speed_mhz;
    assert!((1_700_000..1_900_000).contains(&speed), "{speed}");
    bench.run_for(1_000_000);
    // A tick more or less of an interval of 8,900 is 0.2 Hz.
    assert!((bench.node.status().axes[0].speed_mhz - speed).abs() < 210);
    bench.jog(r#"{"axis":0,"run":"backward","speed_hz":2000,"accel":6000}"#);
    bench.run_for(400_000);
    bench.jog(r#"{"axis":0,"to":777,"speed_hz":4000,"accel":8000}"#);
    bench.run_for(5_000_000);
    assert_eq!(bench.position(X), 777);
    bench.judged();
}

#[test]
fn what_coasts_keeps_the_speed_of_its_ramp_also_at_the_end_of_it() {
    // Steps by 40 Hz, and rest 22 ms behind the last one: that is no step of 45 Hz.
    let mut bench = bench();
    bench.jog(r#"{"axis":0,"to":27,"speed_hz":40,"accel":2032}"#);
    while bench.position(X) < 27 {
        bench.run_for(100);
    }
    bench.run_for(12_000);
    bench.jog(r#"{"axis":0,"coast":true,"lease_ms":2000}"#);
    bench.run_for(1_500_000);
    let made = bench.position(X) - 27;
    // It had slowed down to some 20 Hz.
    assert!((20..40).contains(&made), "{made}");
    bench.run_for(2_000_000);
    assert_eq!(state(&bench), NodeState::Idle);
    bench.judged();
}

#[test]
fn an_axis_that_was_left_within_a_step_goes_on_no_faster_than_it_may() {
    const SLOW: &str = r#"{"axis":0,"run":"forward","speed_hz":3,"accel":213,"lease_ms":9000}"#;
    // It rests 12 ms after the stop, at any part of a step.
    for (stop_ms, again_ms) in [(10, 0), (60, 5), (60, 11), (60, 20), (120, 90), (150, 20)] {
        let mut bench = bench();
        bench.jog(SLOW);
        while bench.position(X) < 2 {
            bench.run_for(1_000);
        }
        bench.run_for(stop_ms * 1_000);
        bench.jog(r#"{"axis":0,"stop":true}"#);
        bench.run_for(again_ms * 1_000);
        bench.jog(SLOW);
        bench.run_for(2_000_000);
        bench.jog(r#"{"axis":0,"stop":true}"#);
        bench.run_for(1_000_000);
        let life = bench.judged();
        for pair in steps_of(&life, X).windows(2) {
            let hz = 1.0 / (pair[1].0 - pair[0].0);
            assert!(hz < 3.001, "{stop_ms} ms, {again_ms} ms: {hz} Hz");
        }
    }
}

#[test]
fn axes_are_jogged_each_by_itself() {
    let mut bench = bench();
    bench.jog(r#"{"axis":0,"run":"forward","speed_hz":1000,"accel":4000,"lease_ms":5000}"#);
    bench.jog(r#"{"axis":1,"to":-300,"speed_hz":500,"accel":4000}"#);
    bench.run_for(2_000_000);
    assert_eq!(bench.position(Y), -300);
    let stopped = bench.jog(r#"{"axis":1,"stop":true}"#);
    assert_eq!(stopped["moving"], false, "it rests already");
    assert_eq!(state(&bench), NodeState::Running);
    let stopped = bench.jog(r#"{"stop":true}"#);
    assert_eq!(stopped["moving"], true, "it slows down");
    bench.run_for(1_000_000);
    assert_eq!(state(&bench), NodeState::Idle);
    let stopped = bench.jog(r#"{"stop":true}"#);
    assert_eq!(stopped["moving"], false);
    bench.judged();
}

#[test]
fn an_axis_rests_behind_its_last_step_also_while_another_one_goes_on() {
    let mut bench = bench();
    bench.jog(r#"{"axis":1,"run":"forward","speed_hz":2000,"accel":5000,"lease_ms":5000}"#);
    bench.jog(r#"{"axis":0,"run":"backward","speed_hz":5,"accel":7000,"lease_ms":5000}"#);
    // Its steps are 200 ms apart: the next one is in the pulse hardware already.
    while bench.position(X) > -2 {
        bench.run_for(100);
    }
    bench.run_for(199_500);
    bench.jog(r#"{"axis":0,"stop":true}"#);
    let (mut told, mut ended_at) = (true, None);
    for _ in 0..100 {
        bench.run_for(100);
        // The same question again changes nothing.
        let answer = bench.jog(r#"{"axis":0,"stop":true}"#);
        let moves = answer["moving"] == true;
        if told && !moves {
            ended_at = Some(answer["position"].clone());
        }
        told = moves;
    }
    assert_eq!(bench.position(X), -3);
    assert_eq!(ended_at, Some(serde_json::json!(-3)));
    bench.jog(r#"{"stop":true}"#);
    bench.run_for(2_000_000);
    bench.judged();
}

#[test]
fn what_is_wrong_is_named_and_moves_nothing() {
    let mut bench = bench();
    for (request, expected) in [
        ("", "bad_json: not a JSON object"),
        ("[0,1]", "bad_json: not a JSON object"),
        (r#"{"axes":0}"#, "bad_json: unknown field `axes`"),
        (r#"{"axis":-1}"#, "bad_json: invalid value"),
        (r#"{"axis":0}"#, "bad_command: exactly one of"),
        (
            r#"{"axis":0,"by":1,"speed_hz":10}"#,
            "bad_command: accel: missing",
        ),
        (
            r#"{"axis":9,"by":1,"speed_hz":10,"accel":1}"#,
            "bad_command: there is no axis 9",
        ),
        (
            r#"{"axis":0,"by":1,"speed_hz":1000000,"accel":1,"lease_ms":10}"#,
            "bad_command: lease_ms",
        ),
        (
            r#"{"axis":0,"coast":true}"#,
            "not_allowed: the axis does not move",
        ),
        (r#"{"renew":5}"#, "not_allowed: jog 5 is over"),
        (r#"{"axis":7,"stop":true}"#, "bad_command: axis"),
    ] {
        let refusal = bench.refusal(request);
        assert!(refusal.starts_with(expected), "{request}: {refusal}");
    }
    let long = format!("{{{}}}", " ".repeat(2_000));
    assert_eq!(bench.refusal(&long), "bad_json: more than 1024 bytes");
    bench.run_for(1_000_000);
    assert_eq!(bench.judged().edges.len(), 0);
}

const RUN: &str = r#"{"axis":0,"run":"forward","speed_hz":1000,"accel":4000}"#;

#[test]
fn a_jog_that_is_taken_back_while_the_one_before_it_ends_is_over_when_that_rests() {
    // At whatever time it comes: while the axis can be led elsewhere, when all of its rest is in the
    // pulse hardware, when it rests.
    for after_us in (1_000..3_000).step_by(20) {
        let mut bench = bench();
        bench.jog(RUN);
        bench.run_for(8);
        bench.jog(r#"{"axis":0,"stop":true}"#);
        bench.run_for(after_us);
        bench.jog(r#"{"axis":0,"to":-616,"speed_hz":7,"accel":284}"#);
        bench.run_for(5);
        bench.jog(r#"{"axis":0,"stop":true}"#);
        bench.run_for(1_000_000);
        assert_eq!(state(&bench), NodeState::Idle, "{after_us} µs");
        // And the next one begins.
        bench.jog(r#"{"axis":0,"to":-5,"speed_hz":100,"accel":1000}"#);
        bench.run_for(1_000_000);
        assert_eq!(bench.position(X), -5, "{after_us} µs");
        bench.judged();
    }
}

#[test]
fn it_is_refused_while_a_job_runs_and_a_job_waits_until_it_rests() {
    let mut bench = bench();
    let job = Command::Move {
        axis: Y,
        delay_us: 1_000,
        steps: 500,
    };
    bench.order([job]);
    assert_eq!(bench.refusal(RUN), "not_allowed: a job runs");
    bench.run_to_rest();
    bench.jog(RUN);
    bench.run_for(200_000);
    bench.order([job]);
    assert_eq!(bench.refusal(RUN), "not_allowed: a job runs");
    bench.run_for(250_000);
    assert_eq!(bench.position(Y), 500, "the job waits");
    bench.run_to_rest();
    assert_eq!(bench.position(Y), 1_000);
    assert_eq!(state(&bench), NodeState::Idle);
    bench.judged();
}

#[test]
fn a_stop_ends_it_and_until_the_release_it_is_refused() {
    for mode in [StopMode::Halt, StopMode::Decelerate] {
        let mut bench = bench();
        let jog = bench.jog(RUN)["jog"].clone();
        bench.run_for(400_000);
        bench.stop(mode);
        bench.run_for(1_000_000);
        assert_eq!(state(&bench), NodeState::Stopped);
        let at = bench.position(X);
        let renewal = bench.refusal(&format!(r#"{{"renew":{jog}}}"#));
        assert!(renewal.ends_with("is over"), "{renewal}");
        assert_eq!(
            bench.refusal(RUN),
            "stopped: the node is stopped; release it first"
        );
        bench.release();
        bench.run_for(1_000_000);
        assert_eq!(bench.position(X), at);
        bench.jog(RUN);
        bench.run_for(2_000_000);
        assert!(bench.position(X) > at);
        bench.judged();
    }
}

#[test]
fn a_hold_rests_and_what_was_not_renewed_meanwhile_does_not_go_on() {
    let mut bench = bench();
    bench.jog(RUN);
    bench.run_for(300_000);
    bench.pace(true);
    bench.run_for(2_000_000);
    let at = bench.position(X);
    assert_eq!(
        bench.refusal(RUN),
        "not_allowed: the node is held; resume it first"
    );
    bench.pace(false);
    bench.run_for(1_000_000);
    assert_eq!(bench.position(X), at);
    assert_eq!(state(&bench), NodeState::Idle);
    bench.jog(RUN);
    bench.run_for(1_000_000);
    assert!(bench.position(X) > at);
    bench.judged();
}

fn with_switch() -> EmulatorConfig {
    let mut config = config();
    config.add_switch(X, Switch::Max, 400).expect("room");
    config
}

#[test]
fn a_limit_switch_stops_it_and_it_leaves_the_switch_but_goes_no_further() {
    let mut bench = Bench::new(with_switch());
    bench.jog(RUN);
    bench.run_for(2_000_000);
    assert_eq!(state(&bench), NodeState::Stopped);
    let at = bench.position(X);
    assert!((400..500).contains(&at), "{at}");
    bench.release();
    assert_eq!(
        bench.refusal(RUN),
        "not_allowed: it is at its max limit already"
    );
    bench.jog(r#"{"axis":0,"by":-300,"speed_hz":500,"accel":4000}"#);
    bench.run_for(2_000_000);
    assert_eq!(bench.position(X), at - 300);
    assert_eq!(state(&bench), NodeState::Idle);
    bench.judged();
}

#[test]
fn soft_limits_hold_it_inside() {
    let mut config = config();
    config.motion.soft_limits[0] = Some(SoftLimits {
        min_steps: -100,
        max_steps: 250,
        from_boot: true,
    });
    let mut bench = Bench::new(config);
    bench.jog(r#"{"axis":0,"run":"forward","speed_hz":1000,"accel":4000,"lease_ms":5000}"#);
    bench.run_for(3_000_000);
    assert_eq!(bench.position(X), 250);
    bench.jog(r#"{"axis":0,"to":-5000,"speed_hz":1000,"accel":4000}"#);
    bench.run_for(3_000_000);
    assert_eq!(bench.position(X), -100);
    assert_eq!(state(&bench), NodeState::Idle);
    bench.judged();
}

#[test]
fn a_lost_link_ends_a_run_by_its_lease_and_answers_nobody() {
    let mut bench = bench();
    bench.jog(RUN);
    bench.run_for(200_000);
    bench.node.link(false, bench.now);
    bench.run_for(1_000_000);
    let at = bench.position(X);
    bench.node.link(true, bench.now);
    bench.run_for(1_000_000);
    assert_eq!((bench.position(X), state(&bench)), (at, NodeState::Idle));
    bench.judged();
}

#[test]
fn random_jogs_and_jobs_by_turns_end_where_the_pins_have_led() {
    for seed in seeds(60) {
        println!("seed {seed}");
        let mut random = Random(seed ^ 0x106);
        let mut bench = Bench::new(config());
        for _ in 0..3 + random.below(12) {
            let axis = random.below(2);
            let speed_hz = 1 + random.of_size(13);
            let accel = 200 + random.of_size(17);
            let how = format!(r#""axis":{axis},"speed_hz":{speed_hz},"accel":{accel}"#);
            let request = match random.below(7) {
                0 => format!(r#"{{"run":"forward",{how}}}"#),
                1 => format!(r#"{{"run":"backward",{how}}}"#),
                2 => format!(r#"{{"to":{},{how}}}"#, random.below(4_000) as i64 - 2_000),
                3 => format!(r#"{{"by":{},{how}}}"#, random.below(4_000) as i64 - 2_000),
                4 => format!(r#"{{"axis":{axis},"stop":true}}"#),
                5 => format!(r#"{{"axis":{axis},"coast":true}}"#),
                _ => {
                    bench.order([Command::Move {
                        axis: AxisId(axis as u8),
                        delay_us: 20 + random.of_size(10) as u32,
                        steps: random.of_size(8) as i32,
                    }]);
                    continue;
                }
            };
            // A refusal is an answer, too.
            let _ = bench.ask(&request);
            bench.run_for(random.of_size(21));
        }
        let _ = bench.ask(r#"{"stop":true}"#);
        let end = LocalMicros(bench.now.0 + 60_000_000);
        while bench.now < end && state(&bench) != NodeState::Idle {
            bench.run_for(100_000);
        }
        let status = bench.node.status();
        assert_eq!(
            status.state,
            NodeState::Idle,
            "seed {seed}: {:?}",
            status.axes
        );
        bench.judged();
    }
}
