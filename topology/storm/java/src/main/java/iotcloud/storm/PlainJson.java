package iotcloud.storm;

import java.io.IOException;
import java.math.BigDecimal;
import org.apache.storm.multilang.JsonSerializer;
import org.apache.storm.multilang.NoOutputException;
import org.apache.storm.multilang.ShellMsg;

/**
 * Storm's JSON for components in Python and other languages, with the numbers that C++ has, Long and Double. Storm's own
 * reads a short whole number as an Integer, whose hash may differ: by such a key, tuples of C++ and Python would go to
 * different tasks. A double of many digits it reads as a BigDecimal, which ends the worker that sends it to another one.
 * It is the value of `topology.multilang.serializer`.
 */
public class PlainJson extends JsonSerializer {
  private static final long serialVersionUID = 1;

  @Override
  public ShellMsg readShellMsg() throws IOException, NoOutputException {
    ShellMsg message = super.readShellMsg();
    if (message.getTuple() != null) {
      message.getTuple().replaceAll(PlainJson::plain);
    }
    return message;
  }

  private static Object plain(Object value) {
    if (value instanceof Integer) {
      return ((Integer) value).longValue();
    }
    return value instanceof BigDecimal ? ((BigDecimal) value).doubleValue() : value;
  }
}
