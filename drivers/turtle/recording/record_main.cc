#include <cstdio>
#include <exception>
#include <iostream>
#include <map>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <pthread.h>
#include <signal.h>

#include <iotcloud/drivers/turtle/recording/recorder.h>
#include <iotcloud/drivers/turtle/standalone/device_host.h>

namespace recording = iotcloud::drivers::turtle::recording;

/// Records, plays and imports depth. Exit status 0: done; 1: failed; 2: wrong arguments.
int main(int argc, char** argv) {
  sigset_t stop_signals;
  sigemptyset(&stop_signals);
  sigaddset(&stop_signals, SIGTERM);
  sigaddset(&stop_signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &stop_signals, nullptr);  // before any other thread starts

  CLI::App app{
      "Records depth frames into the format of libfreenect's replay (fakenect), plays such a recording, or makes\n"
      "one of depth images. SIGINT and SIGTERM end it; what was recorded by then is a whole recording.",
      "iotcloud-record"};
  app.footer(
      "examples:\n"
      "  iotcloud-record --source kinect --seconds 20 walk        20 s of a Kinect into the folder walk\n"
      "  iotcloud-record --source simulator --property seed=3 --property person=walks --frames 300 walk\n"
      "  iotcloud-record --play walk                              checks it and says what is in it\n"
      "  iotcloud-record --import images --unit mm walk           16-bit PGM and PNG files of 640x480 pixels\n"
      "Played to a turtle: --property source=recording --property path=walk; to any program that uses libfreenect:\n"
      "  FAKENECT_PATH=walk LD_PRELOAD=.../fakenect/libfreenect.so.0.5 PROGRAM");
  std::string folder, source = "kinect", play, import_from, unit;
  std::vector<std::string> words;
  std::uint64_t frames = 0;
  double seconds = 0, rate = 30, speed = 0;
  auto* folder_option = app.add_option("folder", folder, "the folder of the new recording");
  auto* source_option =
      app.add_option("--source", source, "a kind of the turtle driver's sources")->capture_default_str();
  auto* property =
      app.add_option("--property", words, "key=value of the source, as for the turtle driver; may be repeated")
          ->allow_extra_args(false);
  app.add_option("--frames", frames, "stop after this number of frames")->check(CLI::Range(1, 100'000'000));
  app.add_option("--seconds", seconds, "stop after this time")->check(CLI::Range(0.001, 1e7));
  auto* play_option = app.add_option("--play", play, "a recording to check and play")->excludes(folder_option);
  app.add_option("--speed", speed,
                 "with --play: 1 plays at the recorded pace, 0 (the default) as fast as the files can be read")
      ->check(CLI::Range(0.0, 100.0))
      ->needs(play_option);
  auto* import_option = app.add_option("--import", import_from, "a folder of depth images to make a recording of")
                            ->excludes(play_option)
                            ->excludes(source_option)
                            ->excludes(property);
  auto* unit_option = app.add_option("--unit", unit, "unit of the images' pixels")
                          ->check(CLI::IsMember({"mm", "disparity"}))
                          ->needs(import_option);
  app.add_option("--rate", rate, "with --import: frames a second of the recording")
      ->check(CLI::Range(0.01, 1000.0))
      ->needs(import_option)
      ->capture_default_str();
  import_option->needs(unit_option);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : 2;
  }

  try {
    if (!play.empty()) {
      recording::play({play, speed}, std::cout);
      return 0;
    }
    if (folder.empty()) {
      std::fprintf(stderr, "iotcloud-record: name the folder of the new recording (--help has examples)\n");
      return 2;
    }
    if (!import_from.empty()) {
      const auto pixels = unit == "mm" ? recording::Unit::mm : recording::Unit::disparity;
      recording::import_images({import_from, folder, pixels, rate}, std::cout);
      return 0;
    }
    auto properties = iotcloud::drivers::turtle::parse_properties(words);
    properties["source"] = source;
    recording::record({folder, properties, frames, seconds}, std::cout);
    return 0;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "iotcloud-record: %s\n", e.what());
    return 1;
  }
}
