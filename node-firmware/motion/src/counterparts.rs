//! FastAccelStepper, the library that most ESP32 machines with steppers use, call by call: what does
//! the same here, what is better, and what is missing.
//!
//! Its names are those of version 1.2.7, and of the planner of several axes that is newer. "No
//! counterpart" means that nothing here does it. What surrounds this crate (messages, groups of nodes,
//! the gateway) is not compared.
//!
//! # The engine
//!
//! | FastAccelStepper | here | difference |
//! |---|---|---|
//! | `init(cpu_core)`, `manageSteppers` | [`Motion::new`] | no task of its own: whoever owns it calls [`Motion::poll`] at [`Motion::poll_timeout`]; a late call delays events, never pulses |
//! | `stepperConnectToPin(pin, driver)`, `getStepPin` | [`MotionConfig::axis_count`], [`StepBackend`] | up to [`CHANNELS`] axes that share one timeline; which pin is the back end's business |
//! | drivers MCPWM/PCNT, RMT, I2S direct, I2S mux; `driverType`, `initI2sMux`, `i2sMuxSetBit`, `i2sMuxGetBit` | [`StepBackend`] | one kind of pulse unit, the RMT in wrap mode. No counterpart of I2S with its 32 multiplexed outputs |
//! | `task_rate(ms)`, a stop if it is longer than what is planned | [`Axis::wants_planning`], [`limits::LOW_WATER_TICKS`] | the pulses ask for planning; a planner that is too late is a fault with a name, not a silent stop |
//! | `setExternalCallForPin`, pins ≥ 128 | [`ShiftConfig`], [`io::shift::ShiftPins`] | enable and direction pins, of C and D too; confirmed by the level read back before the first step, with bounded retries and then a fault that names both words. There it is asked for ever, every 4 ms |
//! | `setDebugLed` | no counterpart | |
//! | `detachFromPin`, `reAttachToPin` | no counterpart | |
//!
//! # Pins of one stepper
//!
//! | FastAccelStepper | here | difference |
//! |---|---|---|
//! | `setDirectionPin(pin, high_counts_up, delay_us)`, 200 to 4095 µs on ESP32; `getDirectionPin`, `directionPinHighCountsUp` | [`AxisProfile::dir_setup_ns`], [`AxisProfile::dir_hold_ns`], [`AxisProfile::direction_inverted`] | in ns, from one tick of 62.5 ns to 200 µs; the hold time after the last step is kept too, which its API does not name. |
//! | `setEnablePin`, two pins, low- and high-active; shared pins; `getEnablePinHighActive`, `getEnablePinLowActive` | [`MotionConfig::enables`], [`io::enable::EnableConfig`] | shared by any set of axes |
//! | `enableOutputs`, `disableOutputs` (false while it runs) | [`Motion::enable`], [`Motion::disable`] | the same |
//! | `setAutoEnable`, `setDelayToEnable`, `setDelayToDisable` (several ms of jitter) | [`EnableConfig::delay_on_us`], [`EnableConfig::delay_off_ms`] | the delays are instants to the tick; all axes of the queue go together |
//! | a step's high time is half its interval, 2 ms at most | [`AxisProfile::high_ns`], [`AxisProfile::high_ns_min`], [`AxisProfile::low_ns_min`] | minima of the driver, with the profiles of seventeen in [`Driver`] |
//!
//! # Position and speed
//!
//! | FastAccelStepper | here | difference |
//! |---|---|---|
//! | `getCurrentPosition`, i32; on RMT off by the steps of the command under way, up to 255 | [`Motion::position_steps`], i64 | exact at every instant, also after a stop of any kind: see [`ledger`] |
//! | `setCurrentPosition`, advised only at rest | [`Command::SetPosition`] | a command in its place in the queue, exact while moving; none for a drive under way |
//! | `targetPos` | [`Motion::target_position`] of a drive | its last order's at once; there the task's view of it. The target of a queued move is its own number |
//! | `getPositionAfterCommandsCompleted` | [`Motion::outlook`] tells it with soft limits | whoever feeds the queue adds up what it feeds |
//! | `setPositionAfterCommandsCompleted` | [`Command::SetPosition`] | takes effect when the commands before have ended |
//! | `isRunning` | [`Motion::is_active`], [`Motion::is_driving`], [`Motion::is_driven`] for one axis | and events that tell it: [`MotionEvent::Rest`], [`MotionEvent::DriveEnded`] |
//! | `getMaxSpeedInUs`, `getMaxSpeedInTicks`, `getMaxSpeedInHz`, `getMaxSpeedInMilliHz` | [`AxisProfile::step_ticks_min`], [`AxisProfile::speed_mhz_max`], [`CommandError::TooFast`] | the limit is the driver's (there 200 kHz), and the refusal of a faster move names it; what a core can keep up with is counted by the bench `instructions` |
//! | `setAbsoluteSpeedLimit` (untested, no check) | [`AxisProfile`] | checked |
//! | `setSpeedInUs`, `setSpeedInTicks`, `setSpeedInHz`, `setSpeedInMilliHz`; −1 if out of range | [`Course::interval_us`], [`Course::interval_ticks`], [`Course::hz`], [`Course::mhz`]; scripts drive in all four units; in the queue whole Hz, raw moves µs | part of the order, so no setting is left over from before; no lower bound of speed |
//! | `getSpeedInUs`, `getSpeedInTicks`, `getSpeedInMilliHz` | [`Motion::course`], [`Course::step_ticks`], [`Course::speed_mhz`] | what a drive was asked for; 16 ticks are a µs |
//! | `getCurrentSpeedInUs`, `getCurrentSpeedInMilliHz(realtime)` | [`Motion::speed_mhz`] | that of what was encoded last, at most two half blocks ahead |
//! | `setAcceleration`, `getAcceleration` | [`Course::hz`], [`Course::accel_hz_per_s`], [`Ramp`] | part of the order |
//! | `getCurrentAcceleration` | [`Motion::accel_hz_per_s`] | with sign likewise; of S-curves what it is at that instant, of each axis of a line its own |
//! | `setLinearAcceleration(steps)` | [`RampShape::Trapezoid`], `linear_steps` | the same law at both ends, in closed form; also in flight |
//! | `setJumpStart(step)` | [`RampShape::Trapezoid`], `jump_steps` | the same law |
//! | nothing | [`RampShape::Jerk`] | S-curves with seven phases, also in flight |
//! | nothing (ESP-IDF's example `stepper_motor`: a table) | [`Course::smooth`] | no table, no rounding of periods, the end frequency is reached; changed and stopped in flight |
//!
//! # Moves
//!
//! All of them can be had from outside: queued commands by jobs, drives by `fleet jog`, the key `jog`, and
//! by scripts.
//!
//! | FastAccelStepper | here | difference |
//! |---|---|---|
//! | `move(n)`, relative to the target of a move under way | [`Motion::drive`] with [`Target::By`], [`Command::Ramp`] | likewise; in the queue relative to the command before |
//! | `moveTo(position)`; a new target behind it is silently ignored, far ones wrap around | [`Motion::drive`] with [`Target::To`], [`Command::RampTo`] | turns and comes back; i64 |
//! | `blocking` | [`MotionEvent::DriveEnded`] | nothing blocks |
//! | `MOVE_OK`, `NO_DIRECTION_PIN`, `SPEED_UNDEFINED`, `ACCELERATION_UNDEFINED` | [`DriveError`], [`CommandError`] | undefined cannot be said |
//! | `applySpeedAcceleration` | [`Motion::drive`] with [`Target::By`] of 0 | within 2 ms; there behind what is planned, 20 ms |
//! | `keepRunning`, `runForward`, `runBackward` | [`Target::Forever`] | |
//! | `forwardStep`, `backwardStep`, only when idle | [`Target::By`] of ±1, [`Command::Move`] | |
//! | `moveByAcceleration(a, allow_reverse)` | [`Target::Forever`] with another [`Course`]; [`Motion::coast`] for 0; [`Motion::end_drive_of`] | another sign turns it; the speed that is kept is known to a mHz |
//! | `stopMove` | [`Motion::end_drive_of`], [`Motion::end_drive`] or [`Motion::stop`] with [`StopMode::Decelerate`] | on its path, begins within 2 ms. May not be called from an interrupt: a stop input is a message to the owner |
//! | `stepsToStop` | [`Motion::steps_to_stop`] | exact: includes what the hardware holds, and knows S-curves; raw moves to a few in ten thousand |
//! | `forceStop`, within 20 ms | [`Motion::stop`] with [`StopMode::Halt`] | at once, at the end of the high time; the position is exact. Not from an interrupt either |
//! | `forceStopAndNewPosition`, the position is lost | [`Motion::stop`], then [`Command::SetPosition`] if wanted | the position is never lost |
//! | `rampState`: idle, coast, accelerate, decelerate, reverse, and the direction | [`Motion::gait`], [`Motion::speed_mhz`] | the same five as a type, of lines and raw moves, too; the direction is the sign of the speed |
//! | `isRampGeneratorActive` | [`Motion::is_driving`], [`Motion::is_active`] | |
//! | `isStopping` | [`Motion::is_coming_to_rest`] | |
//! | `isRunningContinuously` | [`Motion::is_endless`] | |
//! | nothing: every move ends at rest | [`Course::passing_mhz`], [`Command::Line`] | a drive passes its target at a speed, and rests behind it unless the next order takes that over; a line is left at the speed with which the next one goes on, and at rest if there is none |
//! | nothing | [`Motion::hold`], [`Motion::resume`], [`Motion::set_speed_percent`] | on the path of ramps and lines, all drives each by its own ramp; raw moves and pauses stand still and go on to the tick |
//! | nothing in 1.2.7; steppers do not know each other | [`Command::Line`], [`lookahead`] | straight lines on four axes, joined at speed |
//! | each stepper moves by itself, with its own target and ramp, while others do | [`Motion::drive`] of each axis | likewise, up to four at a time: each begins within 2 ms while others move, and is changed, turned and ended alone; all stay on one timeline |
//!
//! # The queue
//!
//! | FastAccelStepper | here | difference |
//! |---|---|---|
//! | `setForwardPlanningTimeInMs`, 20 ms | none needed | a change takes effect behind what the hardware holds, 2 ms at most |
//! | `moveTimed(steps, duration, &actual, start)` | [`Command::Move`], [`Command::Pause`] | the interval is given and kept, so the duration is exact. No counterpart of a duration that the steps do not divide into whole µs: there its error is hidden in the last interval, here the sender says how the rest is shared, by a second [`Command::Move`] with an interval of 1 µs more |
//! | `addQueueEntry({ticks, steps, count_up}, start)` | [`Motion::reserve`] | all of a batch or nothing. Intervals in µs instead of ticks. No least duration of 200 µs, no most of 255 steps or 65,535 ticks |
//! | 32 entries | [`CommandRing`] | as many as its memory holds; 4096 on the board |
//! | `AQE_…` results, to be retried | [`Full`], [`CommandError`] | busy pins are no error: the planner makes the time |
//! | `steps = 0` is a pause | [`Command::Pause`] | |
//! | edges at 0, t, 2t, then t of rest | [`Command::Move`] | the same |
//! | `addQueueEntry(NULL, true)` on each stepper, nearly at one time | [`Command::Barrier`], [`Motion::release_barrier`] | at an instant that is given, ±3 ticks between the axes, and told by [`MotionEvent::Started`]; axes then never drift apart |
//! | a pause before the first step of another direction | the same, only what is missing of the time that the steps leave anyway | at most 210 µs by the default profile, and none between ramps; the refills around it may come 100 µs late |
//! | `isQueueEmpty`, `isQueueFull`, `isQueueRunning`, `queueEntries` | [`Motion::credit_commands`], [`Motion::accepted_commands`], [`Motion::executed_commands`], [`Motion::is_active`] | |
//! | `ticksInQueue`, `hasTicksInQueue` | [`Motion::planned_ticks`] | and to run dry is told: [`MotionEvent::Underrun`] |
//! | `getPeriodInUsAfterCommandsCompleted`, `getPeriodInTicksAfterCommandsCompleted` | none needed; [`Motion::course`] of a drive without end | what is planned ends at rest, so there is no speed behind it |
//!
//! # Several axes: `FasNAxis`
//!
//! | FastAccelStepper | here | difference |
//! |---|---|---|
//! | `addAxis`, `setLimitsFromSteppers`, `syncFromSteppers` | [`MotionConfig::axis_count`] | all axes are of one motion from the beginning |
//! | `addLine(positions)`, up to 64 blocks ahead; `block_count`, `pendingBlocks` | [`Command::Line`], [`Motion::accepted_commands`], [`Motion::executed_commands`] | each line has its own speed, acceleration and jerk; every axis' edges lie at their ideal instants, there where a slice of 2 ms of the longest axis puts them |
//! | rest at every vertex that is not straight on, or up to `overshoot_max` steps off the path | [`AxisProfile::junction_hz`], [`lookahead`] | corners are passed at the speed whose jump each axis can bear, exactly on the path |
//! | `endPath` | none needed | the end of what is known is always at rest, and moves on when more comes |
//! | `pump`, to be called often enough | [`Motion::poll`] | |
//! | `isBusy` | [`Motion::is_active`] | |
//! | `hasUnderrun` | [`MotionEvent::Underrun`], [`FaultCode::PLAN_LATE`] | both end at rest on a ramp that was planned before; there the queues stop where they are |
//! | `performedRampUp`, `remainingToStop` | [`Motion::steps_to_stop`] | |
//! | `lastTicks`, `masterAxis` | [`Motion::speed_mhz`] of each axis | no axis leads the others |
//!
//! # The pulse counter
//!
//! | FastAccelStepper | here | difference |
//! |---|---|---|
//! | `attachToPulseCounter`, `readPulseCounter`, `clearPulseCounter`, `pulseCounterAttached`, `dir_pin_readback` | [`StepBackend::counted_steps`] | its count checks the ledger whenever the axes rest ([`MotionEvent::Miscount`]). No counter for the user: the position is exact already |
//! | counts modulo a revolution | no counterpart | the remainder of [`Motion::position_steps`] is that |
//!
//! [`Command::Barrier`]: keys::Command::Barrier
//! [`Command::Line`]: keys::Command::Line
//! [`Command::Move`]: keys::Command::Move
//! [`Command::Pause`]: keys::Command::Pause
//! [`Command::Ramp`]: keys::Command::Ramp
//! [`Command::RampTo`]: keys::Command::RampTo
//! [`Command::SetPosition`]: keys::Command::SetPosition
//! [`Command::SyncMove`]: keys::Command::SyncMove
//! [`Ramp`]: keys::command::Ramp
//! [`RampShape::Jerk`]: keys::command::RampShape::Jerk
//! [`RampShape::Trapezoid`]: keys::command::RampShape::Trapezoid
//! [`StopMode::Decelerate`]: keys::StopMode::Decelerate
//! [`StopMode::Halt`]: keys::StopMode::Halt
//! [`Axis::wants_planning`]: crate::Axis::wants_planning
//! [`AxisProfile`]: crate::AxisProfile
//! [`AxisProfile::dir_hold_ns`]: crate::AxisProfile::dir_hold_ns
//! [`AxisProfile::dir_setup_ns`]: crate::AxisProfile::dir_setup_ns
//! [`Driver`]: crate::Driver
//! [`AxisProfile::high_ns`]: crate::AxisProfile::high_ns
//! [`AxisProfile::junction_hz`]: crate::AxisProfile::junction_hz
//! [`AxisProfile::speed_mhz_max`]: crate::AxisProfile::speed_mhz_max
//! [`AxisProfile::step_ticks_min`]: crate::AxisProfile::step_ticks_min
//! [`Course::accel_hz_per_s`]: crate::Course::accel_hz_per_s
//! [`Course::passing_mhz`]: crate::Course::passing_mhz
//! [`Course::speed_mhz`]: crate::Course::speed_mhz
//! [`Course::step_ticks`]: crate::Course::step_ticks
//! [`FaultCode::PLAN_LATE`]: keys::status::FaultCode::PLAN_LATE
//! [`Motion::accel_hz_per_s`]: crate::Motion::accel_hz_per_s
//! [`Motion::course`]: crate::Motion::course
//! [`Motion::gait`]: crate::Motion::gait
//! [`Motion::is_coming_to_rest`]: crate::Motion::is_coming_to_rest
//! [`Motion::is_endless`]: crate::Motion::is_endless
//! [`Motion::planned_ticks`]: crate::Motion::planned_ticks
//! [`Motion::target_position`]: crate::Motion::target_position
//! [`AxisProfile::high_ns_min`]: crate::AxisProfile::high_ns_min
//! [`AxisProfile::low_ns_min`]: crate::AxisProfile::low_ns_min
//! [`CHANNELS`]: crate::limits::CHANNELS
//! [`CommandError`]: crate::CommandError
//! [`CommandError::TooFast`]: crate::CommandError::TooFast
//! [`CommandRing`]: crate::CommandRing
//! [`Course`]: crate::Course
//! [`Course::hz`]: crate::Course::hz
//! [`Course::interval_ticks`]: crate::Course::interval_ticks
//! [`Course::interval_us`]: crate::Course::interval_us
//! [`Course::mhz`]: crate::Course::mhz
//! [`Course::smooth`]: crate::Course::smooth
//! [`DriveError`]: crate::DriveError
//! [`DriveError::Busy`]: crate::DriveError::Busy
//! [`Full`]: crate::Full
//! [`Motion::accepted_commands`]: crate::Motion::accepted_commands
//! [`Motion::coast`]: crate::Motion::coast
//! [`Motion::credit_commands`]: crate::Motion::credit_commands
//! [`Motion::drive`]: crate::Motion::drive
//! [`Motion::end_drive`]: crate::Motion::end_drive
//! [`Motion::end_drive_of`]: crate::Motion::end_drive_of
//! [`Motion::is_driven`]: crate::Motion::is_driven
//! [`Motion::outlook`]: crate::Motion::outlook
//! [`Motion::executed_commands`]: crate::Motion::executed_commands
//! [`Motion::hold`]: crate::Motion::hold
//! [`Motion::is_active`]: crate::Motion::is_active
//! [`Motion::is_driving`]: crate::Motion::is_driving
//! [`Motion::new`]: crate::Motion::new
//! [`Motion::poll`]: crate::Motion::poll
//! [`Motion::poll_timeout`]: crate::Motion::poll_timeout
//! [`Motion::position_steps`]: crate::Motion::position_steps
//! [`Motion::release_barrier`]: crate::Motion::release_barrier
//! [`Motion::reserve`]: crate::Motion::reserve
//! [`Motion::resume`]: crate::Motion::resume
//! [`Motion::set_speed_percent`]: crate::Motion::set_speed_percent
//! [`Motion::speed_mhz`]: crate::Motion::speed_mhz
//! [`Motion::steps_to_stop`]: crate::Motion::steps_to_stop
//! [`Motion::stop`]: crate::Motion::stop
//! [`MotionConfig::axis_count`]: crate::MotionConfig::axis_count
//! [`MotionEvent::DriveEnded`]: crate::MotionEvent::DriveEnded
//! [`MotionEvent::Miscount`]: crate::MotionEvent::Miscount
//! [`MotionEvent::Rest`]: crate::MotionEvent::Rest
//! [`MotionEvent::Started`]: crate::MotionEvent::Started
//! [`MotionEvent::Underrun`]: crate::MotionEvent::Underrun
//! [`StepBackend`]: crate::StepBackend
//! [`StepBackend::counted_steps`]: crate::StepBackend::counted_steps
//! [`Target::By`]: crate::Target::By
//! [`Target::Forever`]: crate::Target::Forever
//! [`Target::To`]: crate::Target::To
//! [`io::enable::EnableConfig`]: crate::io::enable::EnableConfig
//! [`EnableConfig::delay_on_us`]: crate::io::enable::EnableConfig::delay_on_us
//! [`EnableConfig::delay_off_ms`]: crate::io::enable::EnableConfig::delay_off_ms
//! [`ShiftConfig`]: crate::ShiftConfig
//! [`Motion::enable`]: crate::Motion::enable
//! [`Motion::disable`]: crate::Motion::disable
//! [`MotionConfig::enables`]: crate::MotionConfig::enables
//! [`AxisProfile::direction_inverted`]: crate::AxisProfile::direction_inverted
//! [`io::shift::ShiftPins`]: crate::io::shift::ShiftPins
//! [`ledger`]: crate::ledger
//! [`limits::LOW_WATER_TICKS`]: crate::limits::LOW_WATER_TICKS
//! [`lookahead`]: crate::lookahead
