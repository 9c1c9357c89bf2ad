//! Homing as a machine, without pulses.

extern crate std;

use super::*;
use std::{string::ToString, vec::Vec};

/// A switch on the way: pressed within these steps, and released only so many outside them.
#[derive(Clone, Copy, Debug)]
struct Place {
    from: i64,
    to: i64,
    hysteresis: i64,
}

const NOWHERE: Place = Place {
    from: 1,
    to: 0,
    hysteresis: 0,
};

/// An axis and its switches, a step at a time.
#[derive(Debug)]
struct World {
    /// Steps of the machine itself.
    at: i64,
    /// Position − steps of the machine.
    offset: i64,
    /// Min, max, home.
    places: [Place; 3],
    switches: Switches,
    /// Steps from a halt to rest, by mode.
    halt_steps: u64,
    slow_down_steps: u64,
    /// Stopped by another after so many steps.
    stop_after: Option<u64>,
    longest: u64,
}

const SWITCHES: [Switch; 3] = [Switch::Min, Switch::Max, Switch::Home];

#[derive(Debug, PartialEq, Eq)]
enum End {
    Done { position: i64 },
    Failed(HomeError),
}

impl World {
    fn new(at: i64, places: [Place; 3]) -> Self {
        let mut world = Self {
            at,
            offset: 1_000_000,
            places,
            switches: Switches::default(),
            halt_steps: 1,
            slow_down_steps: 37,
            stop_after: None,
            longest: 0,
        };
        world.look();
        world
    }

    fn look(&mut self) -> Vec<(Switch, bool)> {
        let mut changes = Vec::new();
        for (switch, place) in SWITCHES.into_iter().zip(self.places) {
            let before = self.switches.get(switch);
            let slack = if before { place.hysteresis } else { 0 };
            let there = place.from <= place.to;
            let active = there && (place.from - slack..=place.to + slack).contains(&self.at);
            if active != before {
                self.switches.set(switch, active);
                changes.push((switch, active));
            }
        }
        changes
    }

    fn home(&mut self, config: HomeConfig) -> End {
        let mut machine = HomeMachine::new(config).expect("legal");
        let mut events = Vec::from([HomeEvent::Begin {
            position_steps: self.at + self.offset,
            switches: self.switches,
        }]);
        let mut target = None;
        let mut halting = None;
        let mut steps = 0_u64;
        loop {
            let event = if events.is_empty() {
                self.step(&mut events, &mut target, &mut halting);
                steps += 1;
                if Some(steps) == self.stop_after {
                    events.clear();
                    events.push(HomeEvent::Stopped);
                }
                self.longest += 1;
                assert!(self.longest < 1_000_000, "homing ends");
                continue;
            } else {
                events.remove(0)
            };
            for effect in machine.handle(event) {
                match effect {
                    HomeEffect::Run { to_steps, .. } => {
                        assert_eq!(halting, None, "no run before the axis rests");
                        target = Some(to_steps - self.offset);
                    }
                    HomeEffect::Halt(mode) => {
                        assert!(target.is_some(), "it moves");
                        halting = Some(match mode {
                            StopMode::Halt => self.halt_steps,
                            StopMode::Decelerate => self.slow_down_steps,
                        });
                    }
                    HomeEffect::SetPosition(position) => {
                        assert_eq!((target, halting), (None, None), "it rests");
                        self.offset = position - self.at;
                    }
                    HomeEffect::Done => {
                        assert_eq!((target, halting), (None, None), "it rests");
                        assert!(!machine.is_active());
                        let position = self.at + self.offset;
                        return End::Done { position };
                    }
                    HomeEffect::Failed(error) => {
                        if error != HomeError::Canceled {
                            assert_eq!((target, halting), (None, None), "it rests");
                        }
                        assert!(!machine.is_active());
                        return End::Failed(error);
                    }
                }
            }
        }
    }

    fn step(
        &mut self,
        events: &mut Vec<HomeEvent>,
        target: &mut Option<i64>,
        halting: &mut Option<u64>,
    ) {
        let to = target.expect("homing never waits for nothing");
        let arrived = *halting == Some(0) || (to == self.at && halting.is_none());
        if arrived {
            (*target, *halting) = (None, None);
            let position_steps = self.at + self.offset;
            events.push(HomeEvent::Rest { position_steps });
            return;
        }
        let way = if to == self.at {
            0
        } else {
            (to - self.at).signum()
        };
        self.at += way;
        if let Some(steps) = halting.as_mut() {
            *steps -= 1;
        }
        for (switch, active) in self.look() {
            events.push(HomeEvent::Input {
                switch,
                active,
                at_position_steps: self.at + self.offset,
            });
        }
    }
}

fn min_at(to: i64, hysteresis: i64) -> Place {
    Place {
        from: to - 1_000,
        to,
        hysteresis,
    }
}

fn max_at(from: i64) -> Place {
    Place {
        from,
        to: from + 1_000,
        hysteresis: 3,
    }
}

fn config() -> HomeConfig {
    HomeConfig {
        back_off_steps_max: 500,
        ..HomeConfig::min_switch(10_000)
    }
}

#[test]
fn the_switch_becomes_the_home_position_and_the_axis_pulls_off() {
    let mut world = World::new(3_000, [min_at(0, 5), max_at(8_000), NOWHERE]);
    assert_eq!(world.home(config()), End::Done { position: 200 });
    assert_eq!((world.at, world.offset), (200, 0), "edge 0 is position 0");
}

#[test]
fn every_phase_gives_its_effects_in_order() {
    let mut machine = HomeMachine::new(HomeConfig {
        home_position_steps: -50,
        ..config()
    })
    .expect("legal");
    let run = |to_steps, speed_hz| HomeEffect::Run {
        to_steps,
        speed_hz,
        accel_hz_per_s: 50_000,
    };
    let input = |active, at_position_steps| HomeEvent::Input {
        switch: Switch::Min,
        active,
        at_position_steps,
    };
    let rest = |position_steps| HomeEvent::Rest { position_steps };
    let begin = HomeEvent::Begin {
        position_steps: 700,
        switches: Switches::default(),
    };
    let way = [
        (begin, Vec::from([run(-9_300, 5_000)])),
        (begin, Vec::new()),
        (
            input(true, 0),
            Vec::from([HomeEffect::Halt(StopMode::Decelerate)]),
        ),
        (rest(-250), Vec::from([run(250, 500)])),
        (input(false, 4), Vec::from([run(104, 500)])),
        (rest(104), Vec::from([run(-350, 500)])),
        (
            input(true, -1),
            Vec::from([HomeEffect::Halt(StopMode::Halt)]),
        ),
        (
            rest(-3),
            Vec::from([HomeEffect::SetPosition(-52), run(150, 500)]),
        ),
        (input(false, -46), Vec::new()),
        (rest(150), Vec::from([HomeEffect::Done])),
        (rest(150), Vec::new()),
        (input(true, 150), Vec::new()),
        (HomeEvent::Stopped, Vec::new()),
    ];
    for (number, (event, effects)) in way.into_iter().enumerate() {
        let found: Vec<_> = machine.handle(event).into_iter().collect();
        assert_eq!(found, effects, "event {number}: {event:?}");
    }
    assert!(!machine.is_active());
}

#[test]
fn the_edge_of_the_approach_counts_however_far_the_axis_runs_on() {
    for (halt_steps, hysteresis) in [(0, 0), (0, 9), (1, 5), (20, 0), (20, 30)] {
        for pull_off_steps in [0, 1, 200] {
            for (switch, direction) in [
                (Switch::Min, Direction::Negative),
                (Switch::Max, Direction::Positive),
                (Switch::Home, Direction::Negative),
                (Switch::Home, Direction::Positive),
            ] {
                let flag = Place {
                    from: 3_000,
                    to: 3_400,
                    hysteresis,
                };
                let mut high = max_at(6_000);
                high.hysteresis = hysteresis;
                let mut world = World::new(
                    if direction == Direction::Negative {
                        5_000
                    } else {
                        700
                    },
                    [min_at(0, hysteresis), high, flag],
                );
                world.halt_steps = halt_steps;
                let end = world.home(HomeConfig {
                    switch,
                    direction,
                    home_position_steps: 77,
                    pull_off_steps,
                    ..config()
                });
                let edge = match (switch, direction) {
                    (Switch::Min, _) => 0,
                    (Switch::Max, _) => 6_000,
                    (Switch::Home, Direction::Negative) => 3_400,
                    (Switch::Home, Direction::Positive) => 3_000,
                };
                let case = (halt_steps, hysteresis, pull_off_steps, switch, direction);
                assert!(matches!(end, End::Done { .. }), "{end:?} {case:?}");
                assert_eq!(world.offset, 77 - edge, "{case:?}");
                let off = if pull_off_steps == 0 {
                    -(halt_steps as i64)
                } else {
                    pull_off_steps as i64
                };
                let at = edge - off * i64::from(direction.sign());
                assert_eq!(world.at, at, "{case:?}");
            }
        }
    }
}

#[test]
fn an_axis_that_begins_on_the_switch_backs_off_first() {
    for at in [0, -1, -300] {
        let mut world = World::new(at, [min_at(0, 5), NOWHERE, NOWHERE]);
        assert_eq!(world.home(config()), End::Done { position: 200 });
        assert_eq!(world.offset, 0, "from {at}");
    }
}

#[test]
fn a_switch_that_is_narrower_than_the_overrun_is_found_on_the_way_back() {
    let flag = Place {
        from: 3_000,
        to: 3_010,
        hysteresis: 2,
    };
    let mut world = World::new(5_000, [NOWHERE, NOWHERE, flag]);
    let home = HomeConfig {
        switch: Switch::Home,
        ..config()
    };
    assert_eq!(world.home(home), End::Done { position: 200 });
    assert_eq!(world.offset, -3_010);
}

#[test]
fn each_failure_has_its_reason_and_keeps_the_positions() {
    let fail = |world: &mut World, config: HomeConfig| match world.home(config) {
        End::Failed(error) => {
            assert_eq!(world.offset, 1_000_000, "{error}");
            error
        }
        End::Done { position } => panic!("done at {position}"),
    };
    let mut none = World::new(0, [NOWHERE; 3]);
    assert_eq!(fail(&mut none, config()), HomeError::NotFound);
    assert_eq!(none.at, -10_000, "the whole way, and no further");

    let mut just = World::new(10_000, [min_at(0, 0), NOWHERE, NOWHERE]);
    assert_eq!(just.home(config()), End::Done { position: 200 });
    let mut just_not = World::new(10_001, [min_at(0, 0), NOWHERE, NOWHERE]);
    assert_eq!(fail(&mut just_not, config()), HomeError::NotFound);

    let mut stuck = World::new(300, [min_at(0, 10_000), NOWHERE, NOWHERE]);
    assert_eq!(fail(&mut stuck, config()), HomeError::NotReleased);
    assert_eq!(stuck.at, -37 + 500);

    let other = |at: i64, limit: usize, place: Place| {
        let mut places = [NOWHERE; 3];
        places[limit] = place;
        World::new(at, places)
    };
    let home = |direction| HomeConfig {
        switch: Switch::Home,
        direction,
        ..config()
    };
    let mut min = other(300, 0, min_at(0, 0));
    let way = home(Direction::Negative);
    assert_eq!(fail(&mut min, way), HomeError::WrongLimit(Switch::Min));
    assert_eq!(min.at, -1, "one step to halt");
    let mut max = other(300, 1, max_at(1_000));
    let way = home(Direction::Positive);
    assert_eq!(fail(&mut max, way), HomeError::WrongLimit(Switch::Max));
    assert_eq!(max.at, 1_001);

    let mut begins = other(-3, 0, min_at(0, 0));
    let way = home(Direction::Negative);
    assert_eq!(fail(&mut begins, way), HomeError::WrongLimit(Switch::Min));
    assert_eq!(begins.at, -3, "it did not move");

    // Backing off into the other limit.
    let mut short = World::new(5, [min_at(0, 300), max_at(60), NOWHERE]);
    assert_eq!(
        fail(&mut short, config()),
        HomeError::WrongLimit(Switch::Max)
    );
    assert_eq!(short.at, 61);
}

#[test]
fn an_axis_on_the_other_limit_may_leave_it() {
    let mut world = World::new(8_100, [min_at(0, 5), max_at(8_000), NOWHERE]);
    assert!(world.switches.max);
    assert_eq!(world.home(config()), End::Done { position: 200 });
}

#[test]
fn a_stop_at_any_instant_ends_it() {
    for stop_after in (1..6_000).step_by(7) {
        let mut world = World::new(3_000, [min_at(0, 5), max_at(8_000), NOWHERE]);
        world.stop_after = Some(stop_after);
        match world.home(config()) {
            End::Failed(error) => assert_eq!(error, HomeError::Canceled),
            End::Done { .. } => assert!(stop_after > 3_000, "{stop_after}"),
        }
    }
    // A reason that is there already is not hidden by the stop that it leads to.
    let mut machine = HomeMachine::new(HomeConfig {
        switch: Switch::Home,
        ..config()
    })
    .expect("legal");
    machine.handle(HomeEvent::Begin {
        position_steps: 0,
        switches: Switches::default(),
    });
    let halt = machine.handle(HomeEvent::Input {
        switch: Switch::Min,
        active: true,
        at_position_steps: -5,
    });
    assert_eq!(
        halt.into_iter().collect::<Vec<_>>(),
        [HomeEffect::Halt(StopMode::Halt)]
    );
    let failed: Vec<_> = machine.handle(HomeEvent::Stopped).into_iter().collect();
    let error = HomeError::WrongLimit(Switch::Min);
    assert_eq!(failed, [HomeEffect::Failed(error)]);
}

#[test]
fn a_release_that_does_not_last_is_no_release() {
    let mut machine = HomeMachine::new(config()).expect("legal");
    let mut handle = |event| machine.handle(event).into_iter().collect::<Vec<_>>();
    let input = |active, at_position_steps| HomeEvent::Input {
        switch: Switch::Min,
        active,
        at_position_steps,
    };
    let run = |to_steps| {
        [HomeEffect::Run {
            to_steps,
            speed_hz: 500,
            accel_hz_per_s: 50_000,
        }]
    };
    let mut switches = Switches::default();
    switches.set(Switch::Min, true);
    let begin = HomeEvent::Begin {
        position_steps: 0,
        switches,
    };
    assert_eq!(handle(begin), run(500));
    assert_eq!(handle(input(false, 10)), run(110));
    assert_eq!(handle(input(true, 12)), run(500), "no further than before");
    assert_eq!(handle(input(false, 20)), run(120));
    assert_eq!(
        handle(HomeEvent::Rest {
            position_steps: 120
        }),
        run(-100)
    );
    assert_eq!(
        handle(HomeEvent::Rest {
            position_steps: -100
        }),
        [HomeEffect::Failed(HomeError::NotFoundAgain)]
    );
}

#[test]
fn what_was_overrun_and_is_not_there_on_the_way_back_fails() {
    let mut machine = HomeMachine::new(config()).expect("legal");
    let input = |active, at_position_steps| HomeEvent::Input {
        switch: Switch::Min,
        active,
        at_position_steps,
    };
    machine.handle(HomeEvent::Begin {
        position_steps: 0,
        switches: Switches::default(),
    });
    machine.handle(input(true, -10));
    machine.handle(input(false, -12));
    machine.handle(HomeEvent::Rest {
        position_steps: -40,
    });
    let end = machine.handle(HomeEvent::Rest {
        position_steps: 460,
    });
    let expected = HomeEffects::one(HomeEffect::Failed(HomeError::NotThere));
    assert_eq!(end, expected);
}

#[test]
fn positions_at_the_ends_of_their_range_do_not_overflow() {
    for at in [i64::MIN, i64::MIN + 5, i64::MAX - 5, i64::MAX] {
        for (switch, direction) in [
            (Switch::Min, Direction::Negative),
            (Switch::Max, Direction::Positive),
        ] {
            let mut machine = HomeMachine::new(HomeConfig {
                switch,
                direction,
                home_position_steps: at,
                ..config()
            })
            .expect("legal");
            let input = |active| HomeEvent::Input {
                switch,
                active,
                at_position_steps: at,
            };
            let rest = HomeEvent::Rest { position_steps: at };
            machine.handle(HomeEvent::Begin {
                position_steps: at,
                switches: Switches::default(),
            });
            for event in [
                input(true),
                rest,
                input(false),
                rest,
                input(true),
                rest,
                rest,
            ] {
                machine.handle(event);
            }
            assert!(!machine.is_active());
        }
    }
}

#[test]
fn a_home_that_cannot_be_is_refused() {
    let refused = |change: fn(&mut HomeConfig)| {
        let mut config = config();
        change(&mut config);
        HomeMachine::new(config).err()
    };
    assert_eq!(refused(|_| {}), None);
    let direction = Some(HomeConfigError::Direction);
    assert_eq!(refused(|c| c.direction = Direction::Positive), direction);
    assert_eq!(refused(|c| c.switch = Switch::Max), direction);
    assert_eq!(refused(|c| c.switch = Switch::Home), None);
    let speed = Some(HomeConfigError::Speed);
    assert_eq!(refused(|c| c.approach_hz = 0), speed);
    assert_eq!(refused(|c| c.approach_hz = c.seek_hz + 1), speed);
    assert_eq!(refused(|c| c.approach_hz = c.seek_hz), None);
    let acceleration = Some(HomeConfigError::Acceleration);
    assert_eq!(refused(|c| c.accel_hz_per_s = 0), acceleration);
    let way = Some(HomeConfigError::Way);
    assert_eq!(refused(|c| c.travel_steps_max = 0), way);
    assert_eq!(refused(|c| c.travel_steps_max = HOME_STEPS_MAX + 1), way);
    assert_eq!(refused(|c| c.back_off_steps_max = 0), way);
    assert_eq!(refused(|c| c.margin_steps = 0), way);
    assert_eq!(refused(|c| c.pull_off_steps = HOME_STEPS_MAX + 1), way);
    assert_eq!(refused(|c| c.pull_off_steps = 0), None);
    for error in [direction, speed, acceleration, way].into_iter().flatten() {
        assert!(!error.to_string().is_empty());
    }
    for error in [
        HomeError::NotFound,
        HomeError::NotReleased,
        HomeError::NotThere,
        HomeError::NotFoundAgain,
        HomeError::WrongLimit(Switch::Min),
        HomeError::WrongLimit(Switch::Max),
        HomeError::WrongLimit(Switch::Home),
        HomeError::Canceled,
    ] {
        assert!(!error.to_string().is_empty());
    }
}

#[test]
fn in_any_world_homing_ends_exactly_or_says_why() {
    let mut done_count = 0;
    for seed in 0..2_000_u64 {
        let mut state = seed;
        let mut random = |below: i64| {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut mixed = (state ^ state >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((mixed ^ mixed >> 31) % below as u64) as i64
        };
        let mut high = max_at(1_000 + random(1_000));
        high.hysteresis = random(20);
        let from = random(1_000);
        let flag = Place {
            from,
            to: from + random(200),
            hysteresis: random(20),
        };
        let places = [min_at(0, random(20)), high, flag];
        let places = places.map(|place| if random(8) == 0 { NOWHERE } else { place });
        let mut world = World::new(random(2_500) - 200, places);
        world.halt_steps = random(5) as u64;
        world.slow_down_steps = random(60) as u64;
        let (switch, direction) = match random(4) {
            0 => (Switch::Min, Direction::Negative),
            1 => (Switch::Max, Direction::Positive),
            2 => (Switch::Home, Direction::Negative),
            _ => (Switch::Home, Direction::Positive),
        };
        let before = world.offset;
        let home_position_steps = random(1_000) - 500;
        let end = world.home(HomeConfig {
            switch,
            direction,
            home_position_steps,
            travel_steps_max: 1 + random(3_000) as u64,
            back_off_steps_max: 1 + random(400) as u64,
            margin_steps: 1 + random(100) as u64,
            pull_off_steps: random(100) as u64,
            ..config()
        });
        match end {
            End::Failed(_) if world.offset == before => {}
            End::Failed(error) => {
                let way = limit_of(opposite(direction));
                assert_eq!(error, HomeError::WrongLimit(way), "seed {seed}");
            }
            End::Done { position } => {
                done_count += 1;
                assert_eq!(position, world.at + world.offset, "seed {seed}");
                let place = world.places[match switch {
                    Switch::Min => 0,
                    Switch::Max => 1,
                    Switch::Home => 2,
                }];
                let edge = match direction {
                    Direction::Negative => place.to,
                    Direction::Positive => place.from,
                };
                let home = edge + world.offset;
                assert_eq!(home, home_position_steps, "seed {seed}");
                let off = (position - home) * i64::from(direction.sign());
                assert!(off <= 5, "seed {seed}: {off} steps behind the edge");
            }
        }
    }
    assert!(done_count > 500, "{done_count}");
}
