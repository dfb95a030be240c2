// The value of the original's Kafka records, as its programs were compiled with it (docs/wire.md#envelope): a copy that
// does not include our file, so that a test notices a change of ours that breaks them.
struct TSensorMessage {
  1: string sensorId
  2: string site
  3: binary body
  4: optional map<string, string> properties
}
