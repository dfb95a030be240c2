// All verbs of the program, found as a shell finds them.
#include <fstream>
#include <set>
#include <sstream>

#include <gmock/gmock.h>
#include <unistd.h>
#include <yaml-cpp/yaml.h>

#include <iotcloud/tests/loopback_listener.h>
#include <iotcloud/tests/master/cli/cli_fixture.h>

namespace iotcloud::master::test {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::IsSupersetOf;

Words lines(const std::string& text) {
  Words all;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) all.push_back(line);
  return all;
}

class CliVerbs : public Cli {
 protected:
  /// What can stand in the place of the last word.
  Words complete(Words words) const {
    words.insert(words.begin(), "__complete");
    const auto done = run(words);
    EXPECT_EQ(done.status, 0);
    EXPECT_EQ(done.err, "");
    return lines(done.out);
  }
  /// The same where the master is asked, for which a shell waits a second only: again until a busy one has answered.
  Words complete_names(const Words& words) const {
    return again_until_answered([&] { return complete(words); });
  }
  static Words again_until_answered(const std::function<Words()>& ask) {
    Words found;
    EXPECT_TRUE(eventually([&] {
      found = ask();
      return !found.empty() && !found.front().empty();
    }));
    return found;
  }
  /// Every verb with those above it, from `above` on.
  std::vector<Words> verbs(const Words& above = {}) const {
    std::vector<Words> all;
    auto words = above;
    words.push_back("");
    for (const auto& verb : complete(words)) {
      words.back() = verb;
      const auto help = run([&] {
        auto asked = words;
        asked.push_back("--help");
        return asked;
      }());
      if (help.out.find("Subcommands:") == std::string::npos) {
        all.push_back(words);
      } else {
        for (auto& below : verbs(words)) all.push_back(below);
      }
    }
    return all;
  }
  /// What bash completes behind `line`, with the script sourced: as bash calls the function that the script names.
  Words in_bash(const std::string& line) const {
    constexpr const char* script = R"(
      source <("$0" completion bash)
      [[ $(complete -p iotcloud) == *"-F _iotcloud iotcloud" ]] || echo "not registered"
      read -ra COMP_WORDS <<< "$1"
      if [[ $1 == *' ' ]]; then COMP_WORDS+=(""); fi
      COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
      _iotcloud "$0"
      printf '%s\n' "${COMPREPLY[@]}")";
    const auto done = run_program({"/bin/bash", "-c", script, IOTCLOUD_CLI, line}, {{"IOTCLOUD_MASTER", address()}});
    EXPECT_EQ(done.err, "") << line;
    return lines(done.out);
  }

  /// What zsh is told to offer. Its own functions are stood in for: they want a terminal.
  Words in_zsh(const std::string& line) const {
    constexpr const char* script = R"(
      compdef() { [[ "$*" == "_iotcloud iotcloud" ]] || print "not registered"; }
      compadd() { print -rl -- "${(@P)${@[-1]}}"; }
      _files() { print files; }
      source <("$1" completion zsh)
      words=("${(@s: :)2}")
      words[1]=$1 CURRENT=${#words}
      _iotcloud)";
    const auto done =
        run_program({"/usr/bin/zsh", "-f", "-c", script, "zsh", IOTCLOUD_CLI, line}, {{"IOTCLOUD_MASTER", address()}});
    EXPECT_EQ(done.err, "") << line;
    return lines(done.out);
  }
};

/// Their answers are no records: a script, a status, a token alone on its line, what to do next, a file of its own
/// format, or what another program says.
const std::set<Words> without_output = {{"run"},
                                        {"record"},
                                        {"play"},
                                        {"new", "driver"},
                                        {"new", "bolt"},
                                        {"new", "topology"},
                                        {"new", "project"},
                                        {"support-bundle"},
                                        {"health"},
                                        {"completion"},
                                        {"topology", "check"},
                                        {"topology", "pack"},
                                        {"certs", "init"},
                                        {"certs", "add"},
                                        {"certs", "renew"},
                                        {"certs", "revoke"},
                                        {"token", "add"},
                                        {"token", "renew"},
                                        {"token", "remove"},
                                        {"registry", "export"},
                                        {"registry", "user"}};

TEST_F(CliVerbs, EveryOneThatAnswersTakesAFormatAndHasAnExample) {
  const auto all = verbs();
  EXPECT_THAT(all, IsSupersetOf({Words{"apply"}, Words{"gateways"}, Words{"topology", "kill"}, Words{"completion"}}));
  for (auto words : all) {
    const bool answers = !without_output.contains(words);
    words.push_back("--help");
    const auto help = run(words);
    EXPECT_EQ(help.out.find("--output") != std::string::npos, answers) << testing::PrintToString(words);
    EXPECT_THAT(help.out, AllOf(HasSubstr("Example:"), HasSubstr("iotcloud "))) << testing::PrintToString(words);
  }
}

TEST_F(CliVerbs, JsonAndYamlSayTheSame) {
  FakeGateway gateway(url, "lab1");
  deploy("lab1");
  const std::string file = testing::TempDir() + "iotcloud-verbs-" + std::to_string(getpid()) + ".yaml";
  std::ofstream(file) << "fleet: lab\ndeployments: {m: {plugin: a.so, gateways: [lab1]}}\n";
  for (const Words& verb : std::vector<Words>{{"gateways"},
                                              {"drivers"},
                                              {"status"},
                                              {"topologies"},
                                              {"topology", "list"},
                                              {"diff", "-f", file},
                                              {"apply", "--dry-run", "-f", file},
                                              {"apply", "-f", file},
                                              {"drain", "lab1"},
                                              {"undrain", "lab1"},
                                              {"registry", "adopt", "lab1"},
                                              {"registry", "adopt", "--all"},
                                              {"stop", "--name", "m"},
                                              {"start", "--name", "m"},
                                              {"metadata", "--name", "m", "a=b"},
                                              {"deploy", "a.so", "--all"}}) {
    auto words = verb;
    words.insert(words.end(), {"-o", "json"});
    const auto as_json = run(words);
    ASSERT_TRUE(json::accept(as_json.out)) << testing::PrintToString(words) << as_json.out << as_json.err;
    words.back() = "yaml";
    const auto as_yaml = run(words);
    const auto read = YAML::Load(as_yaml.out);
    EXPECT_EQ(read.size(), json::parse(as_json.out).size()) << testing::PrintToString(words) << as_yaml.out;
  }
  std::remove(file.c_str());
}

TEST_F(CliVerbs, ExitStatusesAreInTheHelp) {
  const auto help = run({"--help"}).out;
  for (const char* text : {"0 done", "1 failed", "2 wrong usage", "3 no master answers", "4 diff"})
    EXPECT_THAT(help, HasSubstr(text));
}

TEST_F(CliVerbs, AShellCompletesVerbsOptionsAndChoices) {
  EXPECT_THAT(complete({"dr"}), ElementsAre("drain", "drivers"));
  EXPECT_THAT(complete({"topology", "re"}), ElementsAre("rebalance"));
  EXPECT_THAT(complete({"drivers", "--st"}), ElementsAre("--state"));
  EXPECT_THAT(complete({"drivers", "--ma"}), ElementsAre("--master")) << "options of the program work everywhere";
  EXPECT_THAT(complete({"drivers", "--state", "in"}), ElementsAre("inactive"));
  EXPECT_THAT(complete({"drivers", "--state=in"}), ElementsAre("--state=inactive"));
  EXPECT_THAT(complete({"drivers", "--state", "=", "in"}), ElementsAre("inactive")) << "as bash takes it apart";
  EXPECT_THAT(complete({"gateways", "-o", ""}), ElementsAre("json", "table", "yaml"));
  EXPECT_THAT(complete({"completion", ""}), ElementsAre("bash", "zsh"));
  EXPECT_THAT(complete({"apply", "-f", "fl"}), ElementsAre(":files"));
  EXPECT_THAT(complete({"token", "add", "anna", "--role", ""}), ElementsAre("admin", "master", "operator", "viewer"));
  EXPECT_THAT(complete({"certs", "init", ""}), ElementsAre(":files"));
  EXPECT_THAT(complete({"nothing", "of", "that", ""}), IsEmpty());
  EXPECT_THAT(complete({}), IsEmpty());
}

TEST_F(CliVerbs, AShellCompletesNamesThatTheMasterKnows) {
  FakeGateway one(url, "lab1");
  FakeGateway two(url, "lab2");
  const auto id = deploy("lab1");
  ASSERT_EQ(run({"deploy", "a.so", "--name", "meter", "--gateway", "lab2"}).status, 0);
  EXPECT_THAT(complete_names({"drain", ""}), ElementsAre("lab1", "lab2"));
  EXPECT_THAT(complete_names({"registry", "adopt", ""}), ElementsAre("lab1", "lab2"));
  EXPECT_THAT(complete_names({"drain", "lab1", "lab"}), ElementsAre("lab1", "lab2")) << "it takes several";
  EXPECT_THAT(complete_names({"drivers", "--gateway", "lab1,la"}), ElementsAre("lab1,lab1", "lab1,lab2"));
  EXPECT_THAT(complete_names({"describe", id.substr(0, 12)}), ElementsAre(id));
  EXPECT_THAT(complete({"describe", id, ""}), IsEmpty()) << "it takes one";
  EXPECT_THAT(complete_names({"stop", "--name", "m"}), ElementsAre("meter"));
  EXPECT_THAT(complete_names({"stop", "--driver", "tu"}), ElementsAre("turtle"));
  EXPECT_THAT(complete_names({"metadata", id.substr(0, 12)}), ElementsAre(id));
}

TEST_F(CliVerbs, WhenNoMasterAnswersNothingIsCompletedAndNothingIsSaid) {
  EXPECT_THAT(complete({"--master", "127.0.0.1:1", "drain", ""}), IsEmpty());
  EXPECT_THAT(complete({"--master", "nonsense", "drain", ""}), IsEmpty());
  EXPECT_THAT(complete({"--token-file", "/nonexistent", "drain", ""}), IsEmpty());
  // One that takes the connection and says nothing.
  const iotcloud::tests::LoopbackListener silent;
  EXPECT_THAT(complete({"--master", "127.0.0.1:" + std::to_string(silent.port()), "drain", ""}), IsEmpty());
}

TEST_F(CliVerbs, BashCompletesWithThePrintedScript) {
  FakeGateway gateway(url, "lab1");
  EXPECT_THAT(in_bash("iotcloud gat"), ElementsAre("gateway", "gateways"));
  EXPECT_THAT(again_until_answered([&] { return in_bash("iotcloud drain "); }), ElementsAre("lab1"));
  EXPECT_THAT(in_bash("iotcloud topology "), Contains("metrics"));
  EXPECT_THAT(in_bash("iotcloud --master 127.0.0.1:1 drain "), ElementsAre(""));
}

TEST_F(CliVerbs, ZshCompletesWithThePrintedScript) {
  if (access("/usr/bin/zsh", X_OK) != 0) GTEST_SKIP() << "there is no zsh; Debian's package is of that name";
  FakeGateway gateway(url, "lab1");
  EXPECT_THAT(in_zsh("iotcloud gat"), ElementsAre("gateway", "gateways"));
  EXPECT_THAT(again_until_answered([&] { return in_zsh("iotcloud drain "); }), ElementsAre("lab1"));
  EXPECT_THAT(in_zsh("iotcloud topology "), Contains("metrics"));
  EXPECT_THAT(in_zsh("iotcloud drivers --state=f"), ElementsAre("--state=failed"));
  EXPECT_THAT(in_zsh("iotcloud apply -f fleet"), ElementsAre("files"));
  EXPECT_THAT(in_zsh("iotcloud --master 127.0.0.1:1 drain "), IsEmpty());
}

}  // namespace
}  // namespace iotcloud::master::test
