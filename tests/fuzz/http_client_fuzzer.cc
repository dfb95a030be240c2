// What anybody may answer to a GET of ours: the bytes of a connection. Whoever asks gets a page, or HttpError.
#include <string>

#include "iotcloud/rpc/http/http_client.h"
#include "iotcloud/tests/fuzz/answering_server.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;

IOTCLOUD_FUZZ_TARGET(http_client, 2'000) {
  auto& server = fuzz::answering_server();
  server.answer_with(std::string(fuzz::text(data, size)));
  const std::string address = "127.0.0.1:" + std::to_string(server.port());
  rpc::HttpReader reader;
  reader.token = "lab.00";
  reader.largest_page = 1'000;
  try {
    const std::string page = rpc::http_get(address, "/topology?a=1", reader);
    fuzz::must(page.size() <= reader.largest_page, "a page is no larger than was asked for");
  } catch (const rpc::HttpError& error) {
    fuzz::must(std::string(error.what()).starts_with(address), "an error names the address");
  }
}
