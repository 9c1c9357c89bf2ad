//! The table of counterparts is whole: every public function of FastAccelStepper has a row, and every row
//! has an answer.

/// Public functions of `FastAccelStepper.h` and `FastAccelStepperEngine.h`, engine first, as the headers
/// and the documentation of version 1.2.7 name them; then those of `FasNAxis.h`, which is newer.
const NAMES: [&str; 95] = [
    "init",
    "manageSteppers",
    "stepperConnectToPin",
    "setExternalCallForPin",
    "setDebugLed",
    "task_rate",
    "initI2sMux",
    "i2sMuxSetBit",
    "i2sMuxGetBit",
    "getStepPin",
    "driverType",
    "setDirectionPin",
    "getDirectionPin",
    "directionPinHighCountsUp",
    "setEnablePin",
    "getEnablePinHighActive",
    "getEnablePinLowActive",
    "enableOutputs",
    "disableOutputs",
    "setAutoEnable",
    "setDelayToEnable",
    "setDelayToDisable",
    "getCurrentPosition",
    "setCurrentPosition",
    "isRunning",
    "getMaxSpeedInUs",
    "getMaxSpeedInTicks",
    "getMaxSpeedInHz",
    "getMaxSpeedInMilliHz",
    "setAbsoluteSpeedLimit",
    "setSpeedInUs",
    "setSpeedInTicks",
    "setSpeedInHz",
    "setSpeedInMilliHz",
    "getSpeedInUs",
    "getSpeedInTicks",
    "getSpeedInMilliHz",
    "getCurrentSpeedInUs",
    "getCurrentSpeedInMilliHz",
    "setAcceleration",
    "getAcceleration",
    "getCurrentAcceleration",
    "setLinearAcceleration",
    "setJumpStart",
    "applySpeedAcceleration",
    "move",
    "moveTo",
    "keepRunning",
    "isRunningContinuously",
    "runForward",
    "runBackward",
    "forwardStep",
    "backwardStep",
    "moveByAcceleration",
    "stopMove",
    "stepsToStop",
    "isStopping",
    "forceStop",
    "forceStopAndNewPosition",
    "targetPos",
    "moveTimed",
    "setForwardPlanningTimeInMs",
    "addQueueEntry",
    "isQueueEmpty",
    "isQueueFull",
    "isQueueRunning",
    "ticksInQueue",
    "hasTicksInQueue",
    "queueEntries",
    "getPositionAfterCommandsCompleted",
    "setPositionAfterCommandsCompleted",
    "getPeriodInUsAfterCommandsCompleted",
    "getPeriodInTicksAfterCommandsCompleted",
    "rampState",
    "isRampGeneratorActive",
    "detachFromPin",
    "reAttachToPin",
    "attachToPulseCounter",
    "readPulseCounter",
    "clearPulseCounter",
    "pulseCounterAttached",
    "addAxis",
    "setLimitsFromSteppers",
    "syncFromSteppers",
    "addLine",
    "block_count",
    "endPath",
    "pump",
    "isBusy",
    "hasUnderrun",
    "performedRampUp",
    "remainingToStop",
    "lastTicks",
    "masterAxis",
    "pendingBlocks",
];

const TABLE: &str = include_str!("../src/counterparts.rs");

/// Theirs, ours and the difference of each row.
fn rows() -> impl Iterator<Item = [&'static str; 3]> {
    let lines = TABLE.lines().filter_map(|line| line.strip_prefix("//! | "));
    let cells = lines.map(|line| line.trim_end_matches('|').split(" | "));
    cells.filter_map(|mut cells| {
        let three = [cells.next()?, cells.next()?, cells.next().unwrap_or("")];
        three.map(str::trim).into()
    })
}

#[test]
fn every_public_function_of_the_header_has_a_row() {
    let theirs: Vec<_> = rows().map(|[theirs, ..]| theirs).collect();
    for name in NAMES {
        let called = [format!("`{name}`"), format!("`{name}(")];
        let mut cells = TABLE.split('|');
        let is_there = cells.any(|cell| called.iter().any(|name| cell.contains(name)));
        assert!(is_there, "{name} has no row");
    }
    // Each name once: the rows are about all of them, and about nothing that is made up.
    let quoted = theirs
        .iter()
        .flat_map(|cell| cell.split('`').skip(1).step_by(2));
    let called = quoted.map(|name| name.split('(').next().unwrap_or(name));
    let mut called: Vec<_> = called.filter(|name| NAMES.contains(name)).collect();
    called.sort_unstable();
    let mut names = NAMES;
    names.sort_unstable();
    assert!(
        names.windows(2).all(|pair| pair[0] != pair[1]),
        "a name twice"
    );
    called.dedup();
    assert_eq!(called, names);
    assert!(
        theirs.len() >= 70,
        "the table was read: {} rows",
        theirs.len()
    );
}

#[test]
fn every_row_has_an_answer_whose_name_leads_somewhere() {
    for [theirs, ours, difference] in rows().filter(|[theirs, ..]| theirs.contains('`')) {
        let reason = ["no counterpart", "none needed", "nothing", "the same"];
        let said = reason.iter().any(|word| ours.contains(word));
        assert!(said || ours.contains("[`"), "{theirs}: {ours}");
        for cell in [ours, difference] {
            // rustdoc knows whether the item is there, if the name has a link.
            for name in cell
                .split("[`")
                .skip(1)
                .filter_map(|rest| rest.split("`]").next())
            {
                let link = format!("//! [`{name}`]: ");
                assert!(TABLE.contains(&link), "{theirs}: {name} leads nowhere");
            }
        }
    }
}
