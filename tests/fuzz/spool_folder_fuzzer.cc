// A spool's folder as a process finds it: the input is the last two segments and the mark. The spool must always be
// able to continue: it reads appended records after the valid ones in the files.
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>

#include <stdlib.h>
#include <unistd.h>

#include "iotcloud/brokers/spool/store/spool_reader.h"
#include "iotcloud/brokers/spool/store/spool_store.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"
#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>

namespace {

using namespace iotcloud;

class SpoolFolder {
 public:
  SpoolFolder() {
    std::string name = (std::filesystem::exists("/dev/shm") ? "/dev/shm" : "/tmp") + std::string("/spool-fuzz-XXXXXX");
    fuzz::must(mkdtemp(name.data()) != nullptr, "there is a folder to work in");
    path_ = name;
  }
  SpoolFolder(const SpoolFolder&) = delete;
  SpoolFolder& operator=(const SpoolFolder&) = delete;
  ~SpoolFolder() { std::filesystem::remove_all(path_); }
  void clear() {
    for (const auto& file : std::filesystem::directory_iterator(path_)) std::filesystem::remove(file.path());
  }
  void write(const std::string& name, std::string_view bytes) { std::ofstream(path_ + "/" + name) << bytes; }
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

/// Takes the input's next part, which begins with its length in two bytes.
std::string_view take_part(std::string_view& input) {
  if (input.size() < 2) return {};
  const std::size_t size = static_cast<unsigned char>(input[0]) + 256u * static_cast<unsigned char>(input[1]);
  const std::string_view part = input.substr(2, size);
  input.remove_prefix(2 + part.size());
  return part;
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(spool_folder, 4'000) {
  config::set_log_level(config::LogLevel::off);
  static SpoolFolder folder;
  std::string_view input = fuzz::text(data, size);
  folder.clear();
  folder.write("mark", take_part(input));
  folder.write("00000000000000000001.segment", take_part(input));
  folder.write("00000000000000000003.segment", input);
  brokers::spool::SpoolStore::Options options;
  options.folder = folder.path();
  options.synced = false;
  try {
    brokers::spool::SpoolStore store(options);
    brokers::Message message;
    message.driver_id = "appended";
    brokers::spool::Position where;
    fuzz::must(store.append(1, message, where) == brokers::spool::SpoolStore::Append::stored, "a spool can go on");
    brokers::spool::SpoolReader reader(store);
    std::string last;
    while (const auto record = reader.next()) last = record->message.driver_id;
    fuzz::must(last == "appended", "what is appended is read, last");
  } catch (const config::Error&) {
    // Written by a later version.
  }
}
