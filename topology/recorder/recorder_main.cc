// iotcloud-recorder: records channels of a running system, says what is in a recording, and plays it. `iotcloud
// record`, `iotcloud info` and `iotcloud play` start it.
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <set>
#include <thread>
#include <utility>

#include <CLI/CLI.hpp>
#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/config/log_settings.h>
#include <iotcloud/config/output/output.h>
#include <iotcloud/topology/recorder/play.h>
#include <iotcloud/topology/recorder/record.h>

namespace {

using namespace iotcloud;
namespace output = config::output;
using Json = nlohmann::ordered_json;

/// Blocks the signals that end the process before any thread exists, so that only those who wait for them get them.
sigset_t block_ending_signals() {
  sigset_t ending;
  sigemptyset(&ending);
  sigaddset(&ending, SIGINT);
  sigaddset(&ending, SIGTERM);
  sigaddset(&ending, SIGUSR1);  // of this program's own threads
  pthread_sigmask(SIG_BLOCK, &ending, nullptr);
  return ending;
}

/// Requests a stop when the process is told to end.
class StopBySignal {
 public:
  explicit StopBySignal(const sigset_t& ending)
      : waiter_([this, ending](const std::stop_token& end) {
          while (!end.stop_requested()) {
            const int signal = sigtimedwait(&ending, nullptr, &moment);
            if (signal > 0) stop_.request_stop();
          }
        }) {}
  std::stop_token token() const { return stop_.get_token(); }

 private:
  static constexpr timespec moment{0, 50'000'000};
  std::stop_source stop_;
  std::jthread waiter_;
};

struct Words {
  std::string file;
  recorder::SystemOptions system;
  std::vector<std::string> broker_words;
  std::string log_level = "warn";
  // record
  std::string where, direction = "out", compression = "zstd", group;
  std::vector<std::string> channels;
  double seconds = 0;
  std::uint64_t messages = 0, megabytes = 0;
  // info
  std::string format = "table";
  bool check = false;
  // play
  std::string topology;
  std::vector<std::string> to_words;
  recorder::PlayOptions play;
  std::string times = "recorded";
};

/// KEY=VALUE. \throws config::Error.
std::pair<std::string, std::string> pair_of(const std::string& option, const std::string& word) {
  const auto equals = word.find('=');
  if (equals == 0 || equals == std::string::npos || equals + 1 == word.size())
    throw config::Error(option + ": \"" + word + "\" is not of the form A=B");
  return {word.substr(0, equals), word.substr(equals + 1)};
}

std::string byte_words(std::uint64_t bytes) {
  constexpr double kilo = 1000, mega = 1000 * kilo;
  const auto count = static_cast<double>(bytes);
  return count >= mega   ? fmt::format("{:.1f} MB", count / mega)
         : count >= kilo ? fmt::format("{:.1f} kB", count / kilo)
                         : fmt::format("{} B", bytes);
}

double seconds_of(std::chrono::nanoseconds time) {
  return std::chrono::duration<double>(time).count();
}

int record(const Words& words, const sigset_t& ending) {
  recorder::RecordOptions options;
  options.file = words.file;
  options.writing.compression = recording::mcap::compression_of(words.compression == "none" ? "" : words.compression);
  if (!words.where.empty()) options.where = discovery::Selection::parse(words.where);
  options.channels = words.channels;
  options.out = words.direction != "in";
  options.in = words.direction != "out";
  options.group = words.group;
  recorder::System system(words.system);
  std::atomic<bool> enough{false};
  const auto main_thread = pthread_self();
  const std::uint64_t most_bytes = words.megabytes * 1'000'000;
  std::atomic<std::uint64_t> came{0};
  recorder::Recorder running(system, options, [&] {
    // A signal of its own wakes the thread that waits for signals.
    if (words.messages > 0 && ++came == words.messages && !enough.exchange(true)) pthread_kill(main_thread, SIGUSR1);
  });
  std::fprintf(stderr, "records into %s as the group %s; Ctrl-C ends it\n", words.file.c_str(),
               running.group().c_str());
  const auto begin = std::chrono::steady_clock::now();
  const auto end =
      words.seconds > 0
          ? begin + std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::duration<double>(words.seconds))
          : std::chrono::steady_clock::time_point::max();
  std::set<std::string> told;
  std::pair<std::size_t, std::size_t> listening;
  recorder::Recorder::Progress progress;
  while (true) {
    const auto now = std::chrono::steady_clock::now();
    if (now >= end || enough) break;
    const auto rest = std::min<std::chrono::nanoseconds>(end - now, std::chrono::seconds(1));
    const timespec wait{static_cast<time_t>(rest.count() / 1'000'000'000),
                        static_cast<long>(rest.count() % 1'000'000'000)};
    const int signal = sigtimedwait(&ending, nullptr, &wait);
    if (signal == SIGINT || signal == SIGTERM) break;
    running.tick();
    progress = running.progress();
    for (const auto& trouble : progress.troubles) {
      if (told.insert(trouble).second)
        std::fprintf(stderr, "iotcloud-recorder: %s\n", output::printable(trouble).c_str());
    }
    if (const std::pair present{progress.listening, progress.channels}; present != listening) {
      listening = present;
      std::fprintf(stderr, "listens to %zu of %zu channels\n", progress.listening, progress.channels);
    }
    if (!progress.failure.empty() || (most_bytes > 0 && progress.bytes >= most_bytes)) break;
  }
  running.close();
  progress = running.progress();
  std::printf("%s: %llu messages of %zu channels in %.1f s, %s\n", words.file.c_str(),
              static_cast<unsigned long long>(progress.messages), progress.channels,
              seconds_of(std::chrono::steady_clock::now() - begin), byte_words(progress.bytes).c_str());
  if (progress.redelivered > 0)
    std::printf("%llu of them may be there twice: a broker handed them over again\n",
                static_cast<unsigned long long>(progress.redelivered));
  if (progress.channels == 0)
    throw config::Error(
        "no channel was recorded: no active driver instance has one that is chosen; `iotcloud channel "
        "list` shows what there is");
  return 0;
}

int info(const Words& words) {
  recording::RecordingReader recording(words.file);
  if (words.check) recording.check();
  const auto& file = recording.file();
  const auto& statistics = file.statistics();
  const double seconds = statistics.messages == 0 ? 0 : seconds_of(recording.end() - recording.start());
  std::uint64_t messages = 0;
  for (const auto count : recording.counts()) messages += count;
  std::vector<std::string> compressions;
  for (const auto& word : file.compressions()) compressions.push_back(word.empty() ? "none" : word);
  Json json{{"file", words.file},
            {"bytes", file.size()},
            {"profile", file.header().profile},
            {"library", file.header().library},
            {"messages", messages},
            {"start_ms", recording.start().count() / 1'000'000},
            {"seconds", seconds},
            {"chunks", statistics.chunks},
            {"compression", compressions},
            {"whole", file.whole()},
            {"problem", file.problem()},
            {"channels", Json::array()}};
  std::vector<std::vector<std::string>> rows;
  for (std::size_t i = 0; i < recording.channels().size(); ++i) {
    const auto& channel = recording.channels()[i];
    const auto count = recording.counts()[i];
    rows.push_back({output::printable(channel.driver), output::printable(channel.instance),
                    output::printable(channel.alias), output::printable(channel.name), channel.out ? "out" : "in",
                    std::to_string(count),
                    seconds > 0 ? fmt::format("{:.1f}", static_cast<double>(count) / seconds) : "-"});
    json["channels"].push_back({{"driver", channel.driver},
                                {"instance", channel.instance},
                                {"name", channel.alias},
                                {"gateway", channel.gateway},
                                {"channel", channel.name},
                                {"direction", channel.out ? "out" : "in"},
                                {"shared", channel.shared},
                                {"messages", count},
                                {"metadata", channel.metadata}});
  }
  if (words.format == "json" || words.format == "yaml") {
    output::print_data(std::cout, words.format == "json" ? output::Format::json : output::Format::yaml, json);
  } else {
    std::cout << fmt::format("{}: {} messages of {} channels, {:.3f} s from {}, {}, {} chunks ({})\n", words.file,
                             messages, recording.channels().size(), seconds,
                             output::moment(recording.start().count() / 1'000'000), byte_words(file.size()),
                             statistics.chunks,
                             compressions.empty() ? "none" : fmt::format("{}", fmt::join(compressions, ", ")));
    output::print_table(std::cout, {"DRIVER", "INSTANCE", "NAME", "CHANNEL", "DIRECTION", "MESSAGES", "PER SECOND"},
                        rows);
  }
  std::cout.flush();
  if (!file.whole()) std::cerr << words.file << ": " << output::printable(file.problem()) << '\n';
  return 0;
}

/// The component libraries of the build and of the installation.
std::vector<std::string> library_folders() {
  const auto program = std::filesystem::read_symlink("/proc/self/exe").parent_path();
  return {program.parent_path() / "plugins", program.parent_path() / "lib/iotcloud/plugins"};
}

int play(Words& words, const sigset_t& ending) {
  words.play.times_now = words.times == "now";
  for (const auto& word : words.to_words) words.play.to.insert(pair_of("--to", word));
  recording::RecordingReader recording(words.file);
  if (!recording.file().whole())
    std::cerr << words.file << ": " << output::printable(recording.file().problem()) << '\n';
  const StopBySignal stop(ending);
  recorder::PlayResult result;
  if (words.topology.empty()) {
    recorder::System system(words.system);
    result = recorder::play_into(system, recording, words.play, stop.token());
  } else {
    const auto print = [](const std::string& line) { std::cout << output::printable(line) << std::endl; };
    result = recorder::play_to_topology(words.topology, library_folders(), recording, words.play, print, stop.token());
  }
  std::cout << fmt::format("{}: {} messages played, {} taken; the latest was {:.1f} ms late\n", words.file,
                           result.played.messages, result.confirmed, seconds_of(result.played.latest) * 1e3);
  for (const auto& [what, count] : result.others) std::cout << fmt::format("{} messages: {}\n", count, what);
  return result.others.empty() ? 0 : 1;
}

void add_system(CLI::App& verb, Words& words) {
  verb.add_option("--config", words.system.config,
                  "YAML with the keys zk.servers, registry.* and brokers, as a topology's file has them; it may be one")
      ->check(CLI::ExistingFile);
  verb.add_option("--registry", words.system.registry, "the registry's URL; zookeeper://127.0.0.1:2181");
  verb.add_option(
          "--broker", words.broker_words,
          "NAME=URL: where a logical broker is, in place of what channels' records say; again for each further one")
      ->allow_extra_args(false);
}

}  // namespace

int main(int argc, char** argv) {
  signal(SIGPIPE, SIG_IGN);
  const sigset_t ending = block_ending_signals();
  Words words;
  CLI::App app{"Records channels of a running system as MCAP files, and plays them.", "iotcloud-recorder"};
  app.require_subcommand(1);
  app.fallthrough();
  app.add_option("--log-level", words.log_level, "debug, info, warn, error or off");

  auto* to_record = app.add_subcommand("record", "Record channels of driver instances into a new file");
  to_record->add_option("FILE", words.file, "the new file (.mcap)")->required();
  to_record->add_option("--where", words.where, "which instances (discovery/selection): 'driver == \"meter\"'; all");
  to_record->add_option("--channel", words.channels, "a channel's name; again for each further one; all")
      ->allow_extra_args(false);
  to_record->add_option("--direction", words.direction, "of channels, as their drivers see it: out, in or both")
      ->check(CLI::IsMember({"out", "in", "both"}))
      ->capture_default_str();
  to_record->add_option("--seconds", words.seconds, "end after so many")->check(CLI::Range(0.01, 1e9));
  to_record->add_option("--messages", words.messages, "end after so many")->check(CLI::PositiveNumber);
  to_record->add_option("--megabytes", words.megabytes, "end when the file has so many")->check(CLI::PositiveNumber);
  to_record->add_option("--compression", words.compression, "zstd, lz4 or none")
      ->check(CLI::IsMember({"zstd", "lz4", "none"}))
      ->capture_default_str();
  to_record->add_option("--group", words.group, "go on as this group, whose recorder was killed");
  add_system(*to_record, words);

  auto* to_tell = app.add_subcommand("info", "Say what is in a recording");
  to_tell->add_option("FILE", words.file, "an MCAP file of any program")->required();
  to_tell->add_flag("--check", words.check, "read all of it, and compare all checksums");
  to_tell->add_option("-o,--output", words.format, "table, json or yaml")
      ->check(CLI::IsMember({"table", "json", "yaml"}))
      ->capture_default_str();

  auto* to_play =
      app.add_subcommand("play", "Play a recording into a running system, or to a topology in this process");
  to_play->add_option("FILE", words.file, "the recording")->required();
  to_play->add_option("--topology", words.topology, "play to the topology of this YAML file, without any server")
      ->check(CLI::ExistingFile);
  to_play->add_option("--speed", words.play.speed, "2 plays twice as fast; 0 as fast as the channels take it")
      ->check(CLI::Range(0.0, 1e6))
      ->capture_default_str();
  to_play->add_flag("--loop", words.play.loop, "again and again");
  to_play->add_option("--times", words.times, "the messages' times: recorded or now")
      ->check(CLI::IsMember({"recorded", "now"}))
      ->capture_default_str();
  to_play->add_option("--instance", words.play.instances, "only this recorded instance: id or name; again for more")
      ->allow_extra_args(false);
  to_play->add_option("--channel", words.play.channels, "only this channel; again for each further one")
      ->allow_extra_args(false);
  to_play->add_flag("--in", words.play.in, "channels to drivers, too: commands are given again");
  to_play
      ->add_option("--to", words.to_words,
                   "RECORDED=ID: the instance that takes a recorded one's place; again for each further one")
      ->allow_extra_args(false);
  add_system(*to_play, words);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  try {
    config::set_log_level(config::parse_log_level(words.log_level));
    for (const auto& word : words.broker_words) words.system.brokers.push_back(pair_of("--broker", word));
    if (to_record->parsed()) return record(words, ending);
    if (to_tell->parsed()) return info(words);
    return play(words, ending);
  } catch (const config::ConfigError& error) {
    std::fprintf(stderr, "iotcloud-recorder: %s\n", error.what());
    return 2;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "iotcloud-recorder: %s\n", error.what());
    return 1;
  }
}
