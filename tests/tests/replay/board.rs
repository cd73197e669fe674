//! The service over a board whose operator takes the processor now and then: jobs are left out and
//! values come late, and the log gives the same bits again.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use taktil_drivers_regmap::registers::BLOCK_BYTES;
use taktil_drivers_regmap::{Config, Loopback, RegisterFile};
use taktil_hal::Nanos;
use taktil_lab_command::replay;
use taktil_machine_service::service::Service;
use taktil_record::Log;
use taktil_rtcore::linux::monotonic;
use taktil_rtcore::trace::Decision;
use taktil_rtcore::{Cycle, FaultCode, Io, Output, Payload, Task};
use taktil_signal::{JogCommand, OperatorMove, Request, Verb};
use taktil_tests::bench::TemporaryFolder;

/// Asks for the drives, and keeps the processor for longer than two periods every so often.
struct Hog {
    request: Output<Request>,
    jog: Output<JogCommand>,
    moves: Output<OperatorMove>,
}

impl Task for Hog {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let verb = if cycle.tick < 40 { Verb::None } else { Verb::Enable };
        let sequence = u32::from(cycle.tick >= 40);
        io.write(&self.request, Request { verb: verb as u32, sequence });
        io.write(&self.jog, JogCommand::default());
        io.write(&self.moves, OperatorMove::default());
        if cycle.tick % 83 == 82 {
            let end = monotonic() + Nanos::from_micros(6_100);
            while monotonic() < end {}
        }
        Ok(())
    }
}

/// Runs the service over a loop-back board for a second and a half, recording to `log`.
fn serve(folder: &TemporaryFolder, log: &Path) {
    let board = Config { path: folder.path().join("board.bin"), ..Config::default() };
    std::fs::write(&board.path, vec![0; BLOCK_BYTES]).unwrap();
    let machine = taktil_tests::root().join("sim/scenes/machine/puma260.toml");
    let text = format!(
        "machine = \"{}\"\ncontract = \"soft\"\n[board]\npath = \"{}\"\n[log]\npath = \"{}\"\n\
         [flight]\nenabled = false\n",
        machine.display(),
        board.path.display(),
        log.display()
    );
    let path = folder.path().join("taktild.toml");
    std::fs::write(&path, text).unwrap();
    let registers = Arc::new(RegisterFile::open(&board).unwrap());
    let mut model = Loopback::new(registers, &board).unwrap();
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for ms in 0..1_500 {
                model.tick(Nanos::from_millis(ms));
                // The skin is touched with something that nobody could guess.
                model.publish_frame(&[300 + (monotonic().0 % 97) as u16; 256]);
                std::thread::sleep(Duration::from_millis(1));
            }
            stop.store(true, Ordering::SeqCst);
        });
        let operator = Box::new(|ports: &mut taktil_rtcore::Ports| {
            let hog = Hog {
                request: ports.output("request"),
                jog: ports.output("jog"),
                moves: ports.output("moves"),
            };
            Ok(Box::new(hog) as Box<dyn Task>)
        });
        let mut service = Service::with_operator(&path, operator).unwrap();
        service.run_until(&stop).unwrap();
    });
}

#[test]
fn a_run_over_a_board_with_overruns_gives_its_bits_again() {
    let folder = TemporaryFolder::new();
    let path = folder.path().join("board.mcap");
    serve(&folder, &path);
    let log = Log::open(&path).unwrap();
    assert!(log.damage().is_none(), "{:?}", log.damage());
    let decisions = log.find("servo.decision").unwrap();
    let skipped: u32 = log
        .messages()
        .filter(|message| message.channel == decisions)
        .map(|message| Decision::decode(&message.body[..Decision::SIZE]).unwrap().skipped)
        .sum();
    assert!(skipped >= 4, "jobs of 6.1 ms in a lane of 2.5 ms leave others out: {skipped}");
    let (outcome, again) = replay::repeat(log).unwrap_or_else(|why| panic!("{why}"));
    assert!(outcome.equal(), "{}", replay::text(&outcome));
    assert_eq!(outcome.fed, ["operator"]);
    assert!(outcome.jobs > 200, "{}", outcome.jobs);
    // Nothing was simulated: of a board nobody knows what pressed on its tactels.
    let refused = taktil_lab_identify::calibrate::read(&path).unwrap_err();
    assert!(refused.contains("it is of a board"), "{refused}");
    // The repeated run is a log of its own.
    assert!(Log::from_bytes(again).unwrap().find("hal.encoders").is_some());
}
